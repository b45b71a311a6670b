/* Elementary functions of many numbers: loops over those that the build links statically (elementary.zig). */

#include <math.h>
#include <stdint.h>

#define EACH(function)                                                                         \
    void dualarm_##function(int64_t count, const double *x, double *out) {                     \
        for (int64_t i = 0; i < count; i++) out[i] = function(x[i]);                           \
    }
#define EACH_PAIR(function)                                                                    \
    void dualarm_##function(int64_t count, const double *x, const double *y, double *out) {    \
        for (int64_t i = 0; i < count; i++) out[i] = function(x[i], y[i]);                     \
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
