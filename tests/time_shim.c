/* Preloaded into a daemon under test: its real-time clock is set by what the file named in SHIM holds as text, in
   milliseconds; while it holds "hang" a look at any clock does not end, as in a stuck loop. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static const char *path;

static void order(char text[32]) {
  int fd = path ? open(path, O_RDONLY) : -1;
  memset(text, 0, 32);
  if (fd < 0) return;
  if (read(fd, text, 31) <= 0) text[0] = 0;
  close(fd);
}

int clock_gettime(clockid_t id, struct timespec *t) {
  static int (*real)(clockid_t, struct timespec *);
  const struct timespec moment = {0, 20000000};
  char text[32];
  if (!real) {
    void *found = dlsym(RTLD_NEXT, "clock_gettime");
    memcpy(&real, &found, sizeof real);
    path = getenv("SHIM");
  }
  for (order(text); !strncmp(text, "hang", 4); order(text)) nanosleep(&moment, NULL);
  int got = real(id, t);
  if (id == CLOCK_REALTIME) {
    long long ns = t->tv_nsec + atoll(text) * 1000000LL, whole = ns / 1000000000LL;
    t->tv_nsec = ns % 1000000000LL;
    if (t->tv_nsec < 0) t->tv_nsec += 1000000000L, whole--;
    t->tv_sec += whole;
  }
  return got;
}
