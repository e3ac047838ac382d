/* Preloaded into every process of a run: appends "command line<TAB>path" to $OPENED_FILES for each file that is opened to be read or written,
   "command line<TAB>network" for each socket that is bound, listened on or connected beyond this machine's own file system. Binding the loopback
   address alone is not noted: urllib3, which Open3D imports, does so to see whether there is IPv6, and nobody can reach it before `listen`. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/types.h>
#include <unistd.h>

typedef int (*open_t)(const char*, int, ...);
typedef int (*openat_t)(int, const char*, int, ...);
typedef FILE* (*fopen_t)(const char*, const char*);

static int real_open(const char* path, int flags, mode_t mode) { return ((open_t)dlsym(RTLD_NEXT, "open"))(path, flags, mode); }

static void write_line(const char* whole) {
  const char* log = getenv("OPENED_FILES");
  if (!log) return;
  char line[12288], command[4096];
  int from = real_open("/proc/self/cmdline", O_RDONLY, 0);
  ssize_t length = from < 0 ? 0 : read(from, command, sizeof command - 1);
  if (from >= 0) close(from);
  if (length < 0) length = 0;
  for (ssize_t i = 0; i < length; ++i) if (command[i] == 0) command[i] = ' ';
  command[length] = 0;
  int size = snprintf(line, sizeof line, "%s\t%s\n", command, whole);
  int to = real_open(log, O_WRONLY | O_APPEND | O_CREAT, 0600);
  if (to >= 0) {
    if (write(to, line, (size_t)size) < 0) _exit(97);
    close(to);
  }
}

static void note(const char* path) {
  char whole[4096];
  if (path && realpath(path, whole)) write_line(whole);
}

typedef int (*address_t)(int, const struct sockaddr*, socklen_t);
static int noted_address(const char* name, int socket, const struct sockaddr* address, socklen_t length) {
  if (address && address->sa_family != AF_UNIX) write_line("network");
  return ((address_t)dlsym(RTLD_NEXT, name))(socket, address, length);
}
int connect(int socket, const struct sockaddr* address, socklen_t length) { return noted_address("connect", socket, address, length); }
static int is_loopback(const struct sockaddr* address, socklen_t length) {
  return address && address->sa_family == AF_INET6 && length >= sizeof(struct sockaddr_in6) &&
         memcmp(&((const struct sockaddr_in6*)address)->sin6_addr, &in6addr_loopback, sizeof in6addr_loopback) == 0;
}
int bind(int socket, const struct sockaddr* address, socklen_t length) {
  if (is_loopback(address, length)) return ((address_t)dlsym(RTLD_NEXT, "bind"))(socket, address, length);
  return noted_address("bind", socket, address, length);
}
typedef int (*listen_t)(int, int);
int listen(int socket, int backlog) {
  struct sockaddr_storage own;
  socklen_t length = sizeof own;
  if (getsockname(socket, (struct sockaddr*)&own, &length) || own.ss_family != AF_UNIX) write_line("network");
  return ((listen_t)dlsym(RTLD_NEXT, "listen"))(socket, backlog);
}

#define MODE va_list rest; va_start(rest, flags); mode_t mode = va_arg(rest, int); va_end(rest)
int open(const char* path, int flags, ...) { MODE; note(path); return real_open(path, flags, mode); }
int open64(const char* path, int flags, ...) { MODE; note(path); return real_open(path, flags, mode); }
int openat(int at, const char* path, int flags, ...) { MODE; note(path); return ((openat_t)dlsym(RTLD_NEXT, "openat"))(at, path, flags, mode); }
int openat64(int at, const char* path, int flags, ...) { MODE; note(path); return ((openat_t)dlsym(RTLD_NEXT, "openat64"))(at, path, flags, mode); }
FILE* fopen(const char* path, const char* how) { note(path); return ((fopen_t)dlsym(RTLD_NEXT, "fopen"))(path, how); }
FILE* fopen64(const char* path, const char* how) { note(path); return ((fopen_t)dlsym(RTLD_NEXT, "fopen64"))(path, how); }
