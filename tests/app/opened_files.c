/* Preloaded into every process of a run: appends "command line<TAB>path" to $OPENED_FILES for each file that is opened to be read or written. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

typedef int (*open_t)(const char*, int, ...);
typedef int (*openat_t)(int, const char*, int, ...);
typedef FILE* (*fopen_t)(const char*, const char*);

static int real_open(const char* path, int flags, mode_t mode) { return ((open_t)dlsym(RTLD_NEXT, "open"))(path, flags, mode); }

static void note(const char* path) {
  const char* log = getenv("OPENED_FILES");
  if (!log || !path) return;
  char line[12288], command[4096], whole[4096];
  if (!realpath(path, whole)) return;
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

#define MODE va_list rest; va_start(rest, flags); mode_t mode = va_arg(rest, int); va_end(rest)
int open(const char* path, int flags, ...) { MODE; note(path); return real_open(path, flags, mode); }
int open64(const char* path, int flags, ...) { MODE; note(path); return real_open(path, flags, mode); }
int openat(int at, const char* path, int flags, ...) { MODE; note(path); return ((openat_t)dlsym(RTLD_NEXT, "openat"))(at, path, flags, mode); }
int openat64(int at, const char* path, int flags, ...) { MODE; note(path); return ((openat_t)dlsym(RTLD_NEXT, "openat64"))(at, path, flags, mode); }
FILE* fopen(const char* path, const char* how) { note(path); return ((fopen_t)dlsym(RTLD_NEXT, "fopen"))(path, how); }
FILE* fopen64(const char* path, const char* how) { note(path); return ((fopen_t)dlsym(RTLD_NEXT, "fopen64"))(path, how); }
