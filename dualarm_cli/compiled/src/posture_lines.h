/* Least times of lines from cells of postures (`posture_lines.c`). */

#ifndef POSTURE_LINES_H
#define POSTURE_LINES_H

#include <stdint.h>

#include "postures.h"

/* Least times of the joints by the distance that they move on a line. */
typedef struct {
    const float *time;    /* [s], (joints, steps) */
    double steps_per_rad; /* resolution of the distance */
    int64_t steps;
    double late; /* time beyond the least up to which displacements are enclosed [s]; 0 to leave them out */
} LineLaw;

/* Displacements of the joints on lines to the target [rad]: bounds for joints that must rise or fall, for others any
   interval with 0. */
typedef struct {
    double low[JOINTS], high[JOINTS];
} Displacements;

/* Cells around the circle of arm angles, over an interval of the platform angle, at one end of a line. */
typedef struct {
    double h[DIRECTIONS]; /* half-widths of the cells [rad] */
    int64_t parts;
    double *corner; /* see `compute_corners`, `compute_bends` and `compute_spans` */
    Bends *bends;
    Span *span;
    uint8_t *needs_line; /* whether the time of the line from each cell is required */
} Circle;

/* Lower line times to the least times from the required cells to any posture at the target, down to a floor [s].

   refinement: number of consecutive cells with a common time. line: times, (parts / refinement,). displacements:
   enlarged by those of all lines that take less than `late` longer, (parts / refinement,). Returns 0, or 1 if out of
   memory. */
int lower_line_times(const LineLaw *law, int free_last, const Circle *from, const Circle *to, int64_t refinement,
                     double floor, double *line, Displacements *displacements);

#endif
