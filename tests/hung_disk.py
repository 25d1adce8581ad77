"""C that makes a disk hang, as far as a process knows it: what it does with files of a folder takes until another file is gone.

And a machine whose memory takes no files: whatever is opened below `/dev/shm` is refused, where that is asked for.
"""

from __future__ import annotations

from pathlib import Path

from monitor_process import compiled

SOURCE = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <stdio.h>
#include <sys/types.h>
#include <unistd.h>
static void wait_for_disk(int fd) {
  char link[64], path[4096];
  const char *folder = getenv("HUNG_FOLDER"), *flag = getenv("HUNG_FLAG");
  ssize_t n;
  if (!folder || !flag) return;
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  n = readlink(link, path, sizeof path - 1);
  if (n < 0) return;
  path[n] = 0;
  if (strncmp(path, folder, strlen(folder))) return;
  while (access(flag, F_OK) == 0) usleep(1000);
}
#define NEXT(name, ...) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))(__VA_ARGS__)
ssize_t pwrite(int fd, const void *data, size_t n, off_t at) { wait_for_disk(fd); return NEXT(pwrite, fd, data, n, at); }
ssize_t pwrite64(int fd, const void *data, size_t n, off64_t at) { wait_for_disk(fd); return NEXT(pwrite64, fd, data, n, at); }
ssize_t write(int fd, const void *data, size_t n) { wait_for_disk(fd); return NEXT(write, fd, data, n); }
int fsync(int fd) { wait_for_disk(fd); return NEXT(fsync, fd); }
int fdatasync(int fd) { wait_for_disk(fd); return NEXT(fdatasync, fd); }
static int refused(const char *path) {
  if (!getenv("NO_MEMORY_FILES") || strncmp(path, "/dev/shm/", 9)) return 0;
  errno = EROFS;
  return 1;
}
#define MODE_OF(flags) va_list more; va_start(more, flags); mode_t mode = flags & O_CREAT ? va_arg(more, mode_t) : 0; va_end(more)
int open(const char *path, int flags, ...) { MODE_OF(flags); return refused(path) ? -1 : NEXT(open, path, flags, mode); }
int open64(const char *path, int flags, ...) { MODE_OF(flags); return refused(path) ? -1 : NEXT(open64, path, flags, mode); }
"""


class HungDisk:
    """The disk of ``folder`` hangs for processes with `environ` from `hang` until `answer`."""

    def __init__(self, place: Path, folder: Path) -> None:
        source = place / "hung.c"
        source.write_text(SOURCE)
        library = compiled(place, source, words=("-shared", "-fPIC", "-std=gnu11", "-ldl"))
        self.flag = place / "hangs"
        self.environ = {"LD_PRELOAD": str(library), "HUNG_FOLDER": str(folder), "HUNG_FLAG": str(self.flag)}

    def hang(self) -> None:
        self.flag.touch()

    def answer(self) -> None:
        self.flag.unlink(missing_ok=True)
