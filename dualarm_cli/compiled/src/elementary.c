/* Inner loops of numpy ufuncs over the statically linked elementary functions (elementary.zig). */

/* The floating-point status flags are restored because numpy warns about flags that are set. */
#include <math.h>
#include <stdint.h>
#include "status_flags.h"

#define UNARY_LOOP(function)                                                                                      \
    void dualarm_##function(char **data, const int64_t *count, const int64_t *stride, void *unused) {             \
        (void)unused;                                                                                             \
        uint64_t flags = status_flags();                                                                          \
        for (int64_t i = 0; i < *count; i++)                                                                      \
            *(double *)(data[1] + i * stride[1]) = function(*(const double *)(data[0] + i * stride[0]));          \
        restore_status_flags(flags);                                                                              \
    }
#define BINARY_LOOP(function)                                                                                     \
    void dualarm_##function(char **data, const int64_t *count, const int64_t *stride, void *unused) {             \
        (void)unused;                                                                                             \
        uint64_t flags = status_flags();                                                                          \
        for (int64_t i = 0; i < *count; i++)                                                                      \
            *(double *)(data[2] + i * stride[2]) =                                                                \
                function(*(const double *)(data[0] + i * stride[0]), *(const double *)(data[1] + i * stride[1])); \
        restore_status_flags(flags);                                                                              \
    }

UNARY_LOOP(sin)
UNARY_LOOP(cos)
UNARY_LOOP(asin)
UNARY_LOOP(acos)
UNARY_LOOP(atan)
UNARY_LOOP(exp)
UNARY_LOOP(log)
UNARY_LOOP(tanh)
UNARY_LOOP(cbrt)
BINARY_LOOP(atan2)
BINARY_LOOP(pow)
