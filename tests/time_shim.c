/* Preloaded into a daemon under test: its real-time clock is set by what the file named in SHIM holds as text, in
   milliseconds; "hang" there makes the next look at any clock last for ever, as a stuck loop would. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

int clock_gettime(clockid_t id, struct timespec *t) {
  static int (*real)(clockid_t, struct timespec *);
  static const char *path;
  char text[32] = {0};
  if (!real) {
    void *found = dlsym(RTLD_NEXT, "clock_gettime");
    memcpy(&real, &found, sizeof real);
    path = getenv("SHIM");
  }
  int got = real(id, t), fd = path ? open(path, O_RDONLY) : -1;
  if (fd >= 0) {
    if (read(fd, text, sizeof text - 1) <= 0) text[0] = 0;
    close(fd);
    if (!strncmp(text, "hang", 4))
      for (;;) pause();
    if (id == CLOCK_REALTIME) {
      long long ns = t->tv_nsec + atoll(text) * 1000000LL, whole = ns / 1000000000LL;
      t->tv_nsec = ns % 1000000000LL;
      if (t->tv_nsec < 0) t->tv_nsec += 1000000000L, whole--;
      t->tv_sec += whole;
    }
  }
  return got;
}
