/* Preloaded into every process of a run: a file system without Unix modes, as NTFS, exFAT and SMB are. Everything can be read by everybody,
   and chmod says yes and changes nothing. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <sys/stat.h>

#define OPENED(call) int result = call; if (result == 0) status->st_mode |= 0777; return result;
#define BY_PATH(name, type) \
  int name(const char* restrict path, struct type* restrict status) { \
    OPENED(((int (*)(const char*, struct type*))dlsym(RTLD_NEXT, #name))(path, status)) \
  }
#define BY_NUMBER(name, type) \
  int name(int file, struct type* status) { OPENED(((int (*)(int, struct type*))dlsym(RTLD_NEXT, #name))(file, status)) }
#define BY_FOLDER(name, type) \
  int name(int folder, const char* restrict path, struct type* restrict status, int flags) { \
    OPENED(((int (*)(int, const char*, struct type*, int))dlsym(RTLD_NEXT, #name))(folder, path, status, flags)) \
  }

BY_PATH(stat, stat)
BY_PATH(stat64, stat64)
BY_PATH(lstat, stat)
BY_PATH(lstat64, stat64)
BY_NUMBER(fstat, stat)
BY_NUMBER(fstat64, stat64)
BY_FOLDER(fstatat, stat)
BY_FOLDER(fstatat64, stat64)

int chmod(const char* path, mode_t mode) { return 0; }
int fchmod(int file, mode_t mode) { return 0; }
int fchmodat(int folder, const char* path, mode_t mode, int flags) { return 0; }
