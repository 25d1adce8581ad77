/* What a Windows library needs when it is linked against msvcrt.dll alone, which every Windows has.
 *
 * Linking the compiler's own C runtime instead would first build it: a minute on a fresh machine, for two functions.
 */
#include <stdarg.h>
#include <stddef.h>

int DllMainCRTStartup(void *library, unsigned long reason, void *reserved);
int DllMainCRTStartup(void *library, unsigned long reason, void *reserved) {
    (void)library, (void)reason, (void)reserved;
    return 1;
}

int _fltused = 1; /* the linker's mark of floating-point code */

int _vsnprintf(char *out, size_t size, const char *format, va_list values);
int snprintf(char *out, size_t size, const char *format, ...);
int snprintf(char *out, size_t size, const char *format, ...) {
    va_list values;
    va_start(values, format);
    int length = _vsnprintf(out, size, format, values);
    va_end(values);
    if (size) out[size - 1] = 0; /* _vsnprintf leaves a full buffer without an end */
    return length;
}

/* Called before a stack frame of more than a page (rax bytes): touches it page by page, because Windows lets the stack grow
 * by one guard page at a time. Keeps all registers. */
void ___chkstk_ms(void);
__attribute__((naked)) void ___chkstk_ms(void) {
    __asm__("pushq %rax\n"
            "pushq %rcx\n"
            "leaq 24(%rsp), %rcx\n" /* the caller's stack pointer */
            "0: cmpq $4096, %rax\n"
            "jb 1f\n"
            "subq $4096, %rcx\n"
            "subq $4096, %rax\n"
            "orb $0, (%rcx)\n"
            "jmp 0b\n"
            "1: subq %rax, %rcx\n"
            "orb $0, (%rcx)\n"
            "popq %rcx\n"
            "popq %rax\n"
            "ret\n");
}
