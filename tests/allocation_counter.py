"""C that counts the calls of the system's allocator by thread; for LD_PRELOAD."""

COUNTER = """
#include <stddef.h>
extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);
static __thread long taken;
long allocations_of_this_thread(void) { return taken; }
void *malloc(size_t n) { taken++; return __libc_malloc(n); }
void *calloc(size_t m, size_t n) { taken++; return __libc_calloc(m, n); }
void *realloc(void *p, size_t n) { taken++; return __libc_realloc(p, n); }
"""
