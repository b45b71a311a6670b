/* Least times of lines from cells of postures, as `posture_lines.c` finds them. */

#ifndef POSTURE_LINES_H
#define POSTURE_LINES_H

#include <stdint.h>

#include "postures.h"

/* Least times that joints need for their ways on lines, (joints, steps), in steps of the way. */
typedef struct {
    const float *time;
    double per_step; /* steps per radian */
    int64_t steps;
} LineLaw;

/* All cells over an interval of the platform angle, of one end of a line. */
typedef struct {
    double h[DIRECTIONS]; /* half-widths */
    int64_t parts;
    double *corner; /* as of `corners_of`, and so on */
    Bends *bends;
    Span *span;
    uint8_t *needed; /* whether its line's time is asked for */
} Circle;

/* Lowers `line` (parts / finer,) to the least times of lines from the cells that are asked for, `finer` of them in a
   row, to any posture at the target, as far as these are not below a floor. Returns 0, or 1 without memory. */
int lower_line_times(const LineLaw *law, int free_last, const Circle *from, const Circle *to, int64_t finer,
                     double floor, double *line);

#endif
