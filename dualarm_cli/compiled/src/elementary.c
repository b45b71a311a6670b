/* Loops of numpy's universal functions over the elementary functions that the build links statically (elementary.zig). */

/* Numpy would warn of the flags that arithmetic leaves: they are put back. */
#include <math.h>
#include <stdint.h>
#include <xmmintrin.h>

#define EACH(function)                                                                                            \
    void dualarm_##function(char **at, const int64_t *count, const int64_t *step, void *unused) {                 \
        (void)unused;                                                                                             \
        unsigned flags = _mm_getcsr();                                                                            \
        for (int64_t i = 0; i < *count; i++)                                                                      \
            *(double *)(at[1] + i * step[1]) = function(*(const double *)(at[0] + i * step[0]));                  \
        _mm_setcsr(flags);                                                                                        \
    }
#define EACH_PAIR(function)                                                                                       \
    void dualarm_##function(char **at, const int64_t *count, const int64_t *step, void *unused) {                 \
        (void)unused;                                                                                             \
        unsigned flags = _mm_getcsr();                                                                            \
        for (int64_t i = 0; i < *count; i++)                                                                      \
            *(double *)(at[2] + i * step[2]) =                                                                    \
                function(*(const double *)(at[0] + i * step[0]), *(const double *)(at[1] + i * step[1]));         \
        _mm_setcsr(flags);                                                                                        \
    }

EACH(sin)
EACH(cos)
EACH(asin)
EACH(acos)
EACH(atan)
EACH(exp)
EACH(log)
EACH(tanh)
EACH(cbrt)
EACH_PAIR(atan2)
EACH_PAIR(pow)
