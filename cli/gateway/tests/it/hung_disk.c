/* A disk that hangs: whoever brings a file onto it waits while the file HANGS is there. For LD_PRELOAD. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <unistd.h>

static int synced(const char *name, int file) {
  int (*next)(int) = (int (*)(int))dlsym(RTLD_NEXT, name);
  const char *hangs = getenv("HANGS");
  while (hangs && access(hangs, F_OK) == 0) usleep(1000);
  return next(file);
}

int fsync(int file) { return synced("fsync", file); }
int fdatasync(int file) { return synced("fdatasync", file); }
