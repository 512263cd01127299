/* A disk that hangs: whoever brings a file onto it or makes a folder waits while the file HANGS is there; where HANGS_BELOW names
   a folder, only for what is below it. For LD_PRELOAD. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int is_below(const char *path) {
  const char *below = getenv("HANGS_BELOW");
  return !below || strncmp(path, below, strlen(below)) == 0;
}

static int concerns(int file) {
  if (!getenv("HANGS_BELOW")) return 1;
  char link[64], path[4096];
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  ssize_t length = readlink(link, path, sizeof path - 1);
  if (length < 0) return 0;
  path[length] = 0;
  return is_below(path);
}

static int hangs(void) {
  const char *hangs = getenv("HANGS");
  return hangs && access(hangs, F_OK) == 0;
}

static int synced(const char *name, int file) {
  int (*next)(int) = (int (*)(int))dlsym(RTLD_NEXT, name);
  while (concerns(file) && hangs()) usleep(1000);
  return next(file);
}

int mkdir(const char *path, mode_t mode) {
  int (*next)(const char *, mode_t) = (int (*)(const char *, mode_t))dlsym(RTLD_NEXT, "mkdir");
  while (is_below(path) && hangs()) usleep(1000);
  return next(path, mode);
}

int fsync(int file) { return synced("fsync", file); }
int fdatasync(int file) { return synced("fdatasync", file); }
