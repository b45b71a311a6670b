/* Cubic splines through knots (`splines.c`). */

#ifndef SPLINES_H
#define SPLINES_H

#include <stdint.h>

int cubic_spline(const double *time, int64_t knots, int64_t joints, const double *first, const double *last,
                 double *position, double *velocity, double *acceleration);
void largest_rates(const double *time, const double *velocity, const double *acceleration, int64_t knots,
                   int64_t joints, double *largest);

#endif
