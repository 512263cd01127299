/* A disk that hangs: whoever brings a file onto it waits while the file HANGS is there; where HANGS_BELOW names a folder, only
   for the files below it. For LD_PRELOAD. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static int concerns(int file) {
  const char *below = getenv("HANGS_BELOW");
  if (!below) return 1;
  char link[64], path[4096];
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  ssize_t length = readlink(link, path, sizeof path - 1);
  if (length < 0) return 0;
  path[length] = 0;
  return strncmp(path, below, strlen(below)) == 0;
}

static int synced(const char *name, int file) {
  int (*next)(int) = (int (*)(int))dlsym(RTLD_NEXT, name);
  const char *hangs = getenv("HANGS");
  while (hangs && concerns(file) && access(hangs, F_OK) == 0) usleep(1000);
  return next(file);
}

int fsync(int file) { return synced("fsync", file); }
int fdatasync(int file) { return synced("fdatasync", file); }
