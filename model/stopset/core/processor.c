/* Which instructions the processor has, for zig's linker only.
 *
 * `target_clones` (c/wide.h) asks these two names which clone to take: on Linux once at load, on Windows at every call. The
 * compiler's run-time library answers; zig's holds them without an answer, so that the narrow clone would run everywhere. Names
 * and bits are those of gcc's and clang's libraries, which is why no other compiler may be given this file.
 */
#include <cpuid.h>
#include <stdint.h>

enum { FEATURE_AVX2 = 10, XMM_AND_YMM = 6 };

struct {
    uint32_t vendor, type, subtype, features[1];
} __cpu_model;

static int wide(void) {
    uint32_t a, b, c, d, saved, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_OSXSAVE)) return 0;
    __asm__ volatile("xgetbv" : "=a"(saved), "=d"(high) : "c"(0)); /* which registers the system saves */
    return (saved & XMM_AND_YMM) == XMM_AND_YMM && __get_cpuid_count(7, 0, &a, &b, &c, &d) && b & bit_AVX2;
}

/* Called before the library's own data is relocated: nothing outside it may be asked. Any vendor says that it was asked. */
int __cpu_indicator_init(void) {
    if (__atomic_load_n(&__cpu_model.vendor, __ATOMIC_ACQUIRE)) return 0;
    if (wide()) __atomic_store_n(&__cpu_model.features[0], UINT32_C(1) << FEATURE_AVX2, __ATOMIC_RELAXED);
    __atomic_store_n(&__cpu_model.vendor, 1, __ATOMIC_RELEASE);
    return 0;
}
