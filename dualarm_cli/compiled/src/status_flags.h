/* Floating-point status flags of the processor: numpy warns about flags that a loop leaves set. */
#ifndef STATUS_FLAGS_H
#define STATUS_FLAGS_H

#include <stdint.h>

#if defined(__x86_64__)
#include <xmmintrin.h>

static inline uint64_t status_flags(void) { return _mm_getcsr(); }

static inline void restore_status_flags(uint64_t flags) { _mm_setcsr((unsigned)flags); }
#elif defined(__aarch64__)
static inline uint64_t status_flags(void) {
    uint64_t flags;
    __asm__ volatile("mrs %0, fpsr" : "=r"(flags));
    return flags;
}

static inline void restore_status_flags(uint64_t flags) {
    __asm__ volatile("msr fpsr, %0" : : "r"(flags));
}
#else
#error "no access to the status flags of this processor"
#endif

#endif
