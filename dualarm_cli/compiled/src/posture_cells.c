/* Cells of (platform angle, arm angle, branch) that together enclose every posture of a flange pose fixed in the world.

   Method: `bound/cells.py`. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "posture_lines.h"

enum { MAX_VARIANTS = 1 << JOINTS };

/* Splits of cells in each direction, and the number of fine cells per possible one from which on they are split. */
enum { SPLITS = 2, MARGINAL = 8 };

/* Least distance of the middles of two joint ranges on different turns [rad]. */
static const double TURN_DISTANCE = 2.0;

/* Intervals of the platform angle, within its cells, from which a pose is within reach. */
typedef struct {
    const int64_t *cell;      /* platform cell of each interval, ascending */
    const double *low, *high; /* [rad] */
    const double *line;       /* lower bounds of the line's time [s] */
    int64_t count;
} Intervals;

/* Ranges within limits of both values of every joint, on up to two turns that meet the limits: [turn][joint][flip]. */
typedef struct {
    double low[2][JOINTS][2], high[2][JOINTS][2];
    uint8_t meets[2][JOINTS][2];
} Box;

/* Output cells; `count` may exceed `capacity`, and the cells beyond it are not written. */
typedef struct {
    int64_t *cell, *branch;
    double *low, *high; /* joints, then platform angle [rad], (capacity, 8) */
    double *line;       /* least time of the line [s] */
    double *least, *most; /* displacements of the joints on the line [rad], (capacity, 7) */
    int64_t capacity, count;
} Cells;

/* Clip a range of a joint at its limits. */
static void clip_to_limits(const Arm *arm, int joint, int flip, double low, double high, Box *box)
{
    const double bottom = arm->lower[joint], top = arm->upper[joint];
    const int bounded = isfinite(bottom) && isfinite(top);
    int is_narrow = bounded && high - low < TURN, turns = 0, meets[3];
    if (is_narrow) {
        /* If any turn meets the limits, the turn nearest to their middle or a neighbour of it does. */
        const double shift = TURN * nearbyint((0.5 * (bottom + top) - 0.5 * (low + high)) / TURN);
        low += shift;
        high += shift;
        for (int k = 0; k < 3; k++) {
            meets[k] = low + (k - 1) * TURN <= top && high + (k - 1) * TURN >= bottom;
            turns += meets[k];
        }
        is_narrow = turns <= (top - bottom <= TURN + ROUNDING ? 2 : 1);
    }
    if (!is_narrow) {
        /* The joint may take any position within its limits. */
        box->low[0][joint][flip] = bottom;
        box->high[0][joint][flip] = top;
        box->meets[0][joint][flip] = 1;
        box->meets[1][joint][flip] = 0;
        return;
    }
    const double turn[2] = {meets[1] ? 0.0 : meets[0] ? -TURN : TURN, meets[0] && meets[1] ? -TURN : TURN};
    for (int k = 0; k < 2; k++) {
        box->low[k][joint][flip] = fmax(low + turn[k], bottom);
        box->high[k][joint][flip] = fmin(high + turn[k], top);
    }
    box->meets[0][joint][flip] = turns > 0;
    box->meets[1][joint][flip] = turns == 2;
}

/* Compute the boxes of an interval of the platform angle, (parts,). */
static void compute_boxes(const Arm *arm, int free_last, const Circle *circle, Box *box)
{
    for (int64_t k = 0; k < circle->parts; k++)
        for (int joint = 0; joint < JOINTS; joint++) {
            const Span span = circle->span[k * JOINTS + joint];
            if (joint == JOINTS - 1 && free_last) {
                clip_to_limits(arm, joint, 0, -INFINITY, INFINITY, box + k);
                clip_to_limits(arm, joint, 1, -INFINITY, INFINITY, box + k);
            } else if (joint % 2) {
                const double low = fmax(span.low, 0.0), high = fmin(span.high, PI), offset = arm->offset[joint];
                clip_to_limits(arm, joint, 0, low - offset, high - offset, box + k);
                clip_to_limits(arm, joint, 1, -high - offset, -low - offset, box + k);
            } else {
                clip_to_limits(arm, joint, 0, span.low, span.high, box + k);
                clip_to_limits(arm, joint, 1, span.low + PI, span.high + PI, box + k);
            }
        }
}

/* Check whether all joints of a branch can be within their limits. */
static int is_possible(const Box *box, int branch)
{
    int possible = 1;
    for (int joint = 0; joint < JOINTS; joint++)
        possible &= box->meets[0][joint][flips(joint, branch)];
    return possible;
}

/* Select the possible branches, as bits. */
static uint8_t possible_branches(const Box *box)
{
    int possible = 0;
    for (int branch = 0; branch < BRANCHES; branch++)
        possible |= is_possible(box, branch) << branch;
    return (uint8_t)possible;
}

/* Enclosures of the fine cells of one branch and part of the circle, one for each combination of turns. */
typedef struct {
    int turns[MAX_VARIANTS], count;
    double low[MAX_VARIANTS][JOINTS + 1], high[MAX_VARIANTS][JOINTS + 1], first[JOINTS];
} Enclosures;

/* Enlarge the enclosure of a fine cell's turns by the cell. */
static void enclose(Enclosures *enclosures, const double *low, const double *high)
{
    int turns = 0, k = 0;
    for (int joint = 0; joint < JOINTS; joint++) {
        const double middle = 0.5 * (low[joint] + high[joint]);
        if (!enclosures->count)
            enclosures->first[joint] = middle;
        turns |= (fabs(middle - enclosures->first[joint]) > TURN_DISTANCE) << joint;
    }
    while (k < enclosures->count && enclosures->turns[k] != turns)
        k++;
    if (k == enclosures->count) {
        enclosures->count++;
        enclosures->turns[k] = turns;
        for (int j = 0; j <= JOINTS; j++) {
            enclosures->low[k][j] = INFINITY;
            enclosures->high[k][j] = -INFINITY;
        }
    }
    for (int j = 0; j <= JOINTS; j++) {
        enclosures->low[k][j] = fmin(enclosures->low[k][j], low[j]);
        enclosures->high[k][j] = fmax(enclosures->high[k][j], high[j]);
    }
}

/* Enclose all turns of a fine cell recursively: those of the joints from `joint` on, with the others fixed. */
static void enclose_turns(Enclosures *enclosures, const Box *box, int branch, int joint, double *low, double *high)
{
    if (joint == JOINTS) {
        enclose(enclosures, low, high);
        return;
    }
    const int flip = flips(joint, branch);
    for (int k = 0; k < 2; k++) {
        if (!box->meets[k][joint][flip])
            continue;
        low[joint] = box->low[k][joint][flip];
        high[joint] = box->high[k][joint][flip];
        enclose_turns(enclosures, box, branch, joint + 1, low, high);
    }
}

/* Append the enclosures to the output, in order of their turns. */
static void append_cells(const Enclosures *enclosures, int64_t cell, int branch, double line,
                         const Displacements *displacements, Cells *cells)
{
    int order[MAX_VARIANTS];
    for (int i = 0; i < enclosures->count; i++) {
        int k = i;
        for (; k > 0 && enclosures->turns[order[k - 1]] > enclosures->turns[i]; k--)
            order[k] = order[k - 1];
        order[k] = i;
    }
    for (int i = 0; i < enclosures->count; i++, cells->count++) {
        if (cells->count >= cells->capacity)
            continue;
        const int64_t n = cells->count;
        cells->cell[n] = cell;
        cells->branch[n] = branch;
        cells->line[n] = line;
        for (int j = 0; j < JOINTS; j++) {
            /* Joints 2, 4 and 6 turn the other way in the flipped branch. */
            const int mirrored = j % 2 && flips(j, branch);
            cells->least[JOINTS * n + j] = mirrored ? -displacements->high[j] : displacements->low[j];
            cells->most[JOINTS * n + j] = mirrored ? -displacements->low[j] : displacements->high[j];
        }
        for (int j = 0; j <= JOINTS; j++) {
            cells->low[(JOINTS + 1) * n + j] = enclosures->low[order[i]][j];
            cells->high[(JOINTS + 1) * n + j] = enclosures->high[order[i]][j];
        }
    }
}

/* Compute the circle of a flange pose; its number of parts is given. */
static void compute_circle(const Arm *arm, const double *R, const double *p, double low, double high, Circle *circle)
{
    Shape shape;
    compute_shape(arm, R, p, low, high, &shape);
    circle->h[0] = 0.5 * (high - low);
    circle->h[1] = PI / (double)circle->parts;
    compute_corners(arm, R, p, &shape, circle->parts, circle->corner);
    compute_bends(arm, &shape, circle->parts, circle->bends);
    compute_spans(circle->parts, circle->h, circle->corner, circle->bends, circle->span);
}

/* Select the branches with postures within limits over an interval of the platform angle, as bits.

   Where few fine cells are possible, enclosures alone may reach into the limits: cells are split. split: a circle of
   SPLITS times as many parts, and its boxes. possible: branches of each fine cell, (parts,). */
static uint8_t branches_within_limits(const Arm *arm, const double *R, const double *p, int free_last, double low,
                                      double high, const uint8_t *possible, int64_t parts, Circle *split, Box *box)
{
    int64_t count = 0;
    int branches = 0, found = 0;
    for (int64_t k = 0; k < parts; k++) {
        branches |= possible[k];
        count += possible[k] != 0;
    }
    if (MARGINAL * count > parts)
        return (uint8_t)branches;
    for (int i = 0; i < SPLITS && found != branches; i++) {
        const double begin = low + (high - low) * i / SPLITS;
        compute_circle(arm, R, p, begin, i + 1 < SPLITS ? low + (high - low) * (i + 1) / SPLITS : high, split);
        compute_boxes(arm, free_last, split, box);
        for (int64_t k = 0; k < split->parts; k++)
            found |= possible_branches(box + k);
    }
    return (uint8_t)(found & branches);
}

/* Allocate the circles of both ends, and one for split cells; return 0 if out of memory. */
static int allocate_circles(int64_t parts, Circle circle[3])
{
    int allocated = 1;
    for (int end = 0; end < 3; end++) {
        const size_t n = (size_t)(end == 2 ? SPLITS * parts : parts);
        circle[end] = (Circle){.parts = (int64_t)n,
                               .corner = malloc(sizeof(double) * 2 * n * JOINTS),
                               .bends = malloc(sizeof(Bends) * n),
                               .span = malloc(sizeof(Span) * n * JOINTS),
                               .needs_line = malloc(n)};
        allocated &= circle[end].corner && circle[end].bends && circle[end].span && circle[end].needs_line;
    }
    return allocated;
}

/* Compute the cells of a flange pose, with the least times of the lines from them to a target.

   R, p: flange pose in the carried frame at platform angle zero, (9,) and (3,). target: end of the line, (3,).
   law: a law without steps gives lines of zero duration. parts: of the circle of arm angles.
   refinement: fine cells per part; they are enclosed together by platform cell, branch, part and turn.
   free_last: whether the last joint is free. cells: if their count exceeds the capacity, it is the required capacity.
   Returns 0, or 1 if out of memory. */
int posture_cells(const Arm *arm, const double *R, const double *p, const double *target, const LineLaw *law,
                  const Intervals *intervals, int64_t parts, int64_t refinement, int64_t free_last, Cells *cells)
{
    const int64_t fine = parts * refinement;
    int64_t max_intervals = 1, begin = 0;
    for (int64_t i = 0; i < intervals->count; i++) {
        begin = i && intervals->cell[i] == intervals->cell[i - 1] ? begin : i;
        max_intervals = i - begin + 1 > max_intervals ? i - begin + 1 : max_intervals;
    }
    Circle circle[3];
    Box *box = malloc(sizeof(Box) * (size_t)((max_intervals + SPLITS) * fine));
    uint8_t *possible = malloc((size_t)(max_intervals * fine));
    double *line_time = malloc(sizeof(double) * (size_t)parts);
    Displacements *displacements = malloc(sizeof(Displacements) * (size_t)parts);
    Enclosures *enclosures = malloc(sizeof(Enclosures));
    int failed = !allocate_circles(fine, circle) || !box || !possible || !line_time || !displacements || !enclosures;
    cells->count = 0;
    for (int64_t first = 0, end; !failed && first < intervals->count; first = end) {
        for (int64_t part = 0; part < parts; part++) {
            line_time[part] = law->steps ? INFINITY : 0.0;
            for (int joint = 0; joint < JOINTS; joint++) {
                displacements[part].low[joint] = law->late > 0.0 ? INFINITY : -INFINITY;
                displacements[part].high[joint] = -displacements[part].low[joint];
            }
        }
        for (end = first; end < intervals->count && intervals->cell[end] == intervals->cell[first]; end++) {
            const double low = intervals->low[end], high = intervals->high[end];
            compute_circle(arm, R, p, low, high, circle);
            compute_boxes(arm, (int)free_last, circle, box + (end - first) * fine);
            uint8_t *interval_possible = possible + (end - first) * fine;
            for (int64_t k = 0; k < fine; k++)
                interval_possible[k] = possible_branches(box + (end - first) * fine + k);
            const uint8_t within = branches_within_limits(arm, R, p, (int)free_last, low, high, interval_possible, fine,
                                                          circle + 2, box + max_intervals * fine);
            for (int64_t k = 0; k < fine; k++)
                interval_possible[k] &= within;
            if (!law->steps)
                continue;
            compute_circle(arm, R, target, low, high, circle + 1);
            for (int64_t k = 0; k < fine; k++)
                circle->needs_line[k] = interval_possible[k];
            failed |= lower_line_times(law, (int)free_last, circle, circle + 1, refinement, intervals->line[end],
                                       line_time, displacements);
        }
        for (int branch = 0; branch < BRANCHES; branch++)
            for (int64_t part = 0; part < parts; part++) {
                enclosures->count = 0;
                for (int64_t i = first; i < end; i++)
                    for (int64_t k = refinement * part; k < refinement * (part + 1); k++) {
                        const Box *fine_box = box + (i - first) * fine + k;
                        double low[JOINTS + 1], high[JOINTS + 1];
                        low[JOINTS] = intervals->low[i];
                        high[JOINTS] = intervals->high[i];
                        if (possible[(i - first) * fine + k] >> branch & 1)
                            enclose_turns(enclosures, fine_box, branch, 0, low, high);
                    }
                append_cells(enclosures, intervals->cell[first], branch, line_time[part], displacements + part, cells);
            }
    }
    for (int k = 0; k < 3; k++) {
        free(circle[k].corner);
        free(circle[k].bends);
        free(circle[k].span);
        free(circle[k].needs_line);
    }
    free(box);
    free(possible);
    free(line_time);
    free(displacements);
    free(enclosures);
    return failed;
}
