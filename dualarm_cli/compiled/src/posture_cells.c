/* Cells of (platform angle, arm angle, branch) that together hold every posture of a flange pose that stands in the
   world: `bound/cells.py` explains the enclosures. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "posture_lines.h"

enum { MOST_VARIANTS = 1 << JOINTS };

static const double APART = 2.0;

/* Parts of the platform's cells from which a pose is within reach. */
typedef struct {
    const int64_t *cell; /* platform cell of each, ascending */
    const double *low, *high, *line; /* what is known of the line's time */
    int64_t count;
} Intervals;

/* Joint ranges within limits, of both values of every joint: on one turn, and on a second one where two turns meet the
   limits. */
typedef struct {
    double low[2][JOINTS][2], high[2][JOINTS][2];
    uint8_t meets[2][JOINTS][2];
} Box;

/* Cells as they are found; no more than `most` are written. */
typedef struct {
    int64_t *cell, *branch;
    double *low, *high, *line; /* low and high (most, 8): joints, then platform angle */
    int64_t most, count;
} Cells;

/* Cuts a range at a joint's limits. */
static void limited(const Arm *arm, int joint, int flip, double low, double high, Box *box)
{
    const double bottom = arm->lower[joint], top = arm->upper[joint];
    const int bounded = isfinite(bottom) && isfinite(top);
    int known = bounded && high - low < TURN, turns = 0, meets[3];
    if (known) {
        /* The nearest turn to the limits' middle: if any turn meets them, it does, or one next to it. */
        const double shift = TURN * nearbyint((0.5 * (bottom + top) - 0.5 * (low + high)) / TURN);
        low += shift;
        high += shift;
        for (int k = 0; k < 3; k++) {
            meets[k] = low + (k - 1) * TURN <= top && high + (k - 1) * TURN >= bottom;
            turns += meets[k];
        }
        known = turns <= (top - bottom <= TURN + ROUNDING ? 2 : 1);
    }
    if (!known) {
        /* Free within the limits. */
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

/* Fills the boxes (parts,) of one interval of the platform angle. */
static void boxes_of(const Arm *arm, int free_last, const Circle *circle, Box *box)
{
    for (int64_t k = 0; k < circle->parts; k++)
        for (int joint = 0; joint < JOINTS; joint++) {
            const Span span = circle->span[k * JOINTS + joint];
            if (joint == JOINTS - 1 && free_last) {
                limited(arm, joint, 0, -INFINITY, INFINITY, box + k);
                limited(arm, joint, 1, -INFINITY, INFINITY, box + k);
            } else if (joint % 2) {
                const double low = fmax(span.low, 0.0), high = fmin(span.high, PI), offset = arm->offset[joint];
                limited(arm, joint, 0, low - offset, high - offset, box + k);
                limited(arm, joint, 1, -high - offset, -low - offset, box + k);
            } else {
                limited(arm, joint, 0, span.low, span.high, box + k);
                limited(arm, joint, 1, span.low + PI, span.high + PI, box + k);
            }
        }
}

/* Whether a branch's joints can be within their limits. */
static int is_possible(const Box *box, int branch)
{
    int possible = 1;
    for (int joint = 0; joint < JOINTS; joint++)
        possible &= box->meets[0][joint][flips(joint, branch)];
    return possible;
}

static uint8_t some_branch(const Box *box)
{
    int possible = 0;
    for (int branch = 0; branch < BRANCHES; branch++)
        possible |= is_possible(box, branch);
    return (uint8_t)possible;
}

/* What fine cells of one branch and part of the circle are enclosed by, by the turns of their joints. */
typedef struct {
    int turns[MOST_VARIANTS], count;
    double low[MOST_VARIANTS][JOINTS + 1], high[MOST_VARIANTS][JOINTS + 1], first[JOINTS];
} Group;

static void enclose(Group *group, const double *low, const double *high)
{
    int turns = 0, k = 0;
    for (int joint = 0; joint < JOINTS; joint++) {
        const double middle = 0.5 * (low[joint] + high[joint]);
        if (!group->count)
            group->first[joint] = middle;
        turns |= (fabs(middle - group->first[joint]) > APART) << joint;
    }
    while (k < group->count && group->turns[k] != turns)
        k++;
    if (k == group->count) {
        group->count++;
        group->turns[k] = turns;
        for (int j = 0; j <= JOINTS; j++) {
            group->low[k][j] = INFINITY;
            group->high[k][j] = -INFINITY;
        }
    }
    for (int j = 0; j <= JOINTS; j++) {
        group->low[k][j] = fmin(group->low[k][j], low[j]);
        group->high[k][j] = fmax(group->high[k][j], high[j]);
    }
}

/* All turns of a fine cell: of the joints from one on, the others being chosen. */
static void each_turn(Group *group, const Box *box, int branch, int joint, double *low, double *high)
{
    if (joint == JOINTS) {
        enclose(group, low, high);
        return;
    }
    const int flip = flips(joint, branch);
    for (int k = 0; k < 2; k++) {
        if (!box->meets[k][joint][flip])
            continue;
        low[joint] = box->low[k][joint][flip];
        high[joint] = box->high[k][joint][flip];
        each_turn(group, box, branch, joint + 1, low, high);
    }
}

static void emit(const Group *group, int64_t cell, int branch, double line, Cells *cells)
{
    int order[MOST_VARIANTS];
    for (int i = 0; i < group->count; i++) {
        int k = i;
        for (; k > 0 && group->turns[order[k - 1]] > group->turns[i]; k--)
            order[k] = order[k - 1];
        order[k] = i;
    }
    for (int i = 0; i < group->count; i++, cells->count++) {
        if (cells->count >= cells->most)
            continue;
        const int64_t n = cells->count;
        cells->cell[n] = cell;
        cells->branch[n] = branch;
        cells->line[n] = line;
        for (int j = 0; j <= JOINTS; j++) {
            cells->low[(JOINTS + 1) * n + j] = group->low[order[i]][j];
            cells->high[(JOINTS + 1) * n + j] = group->high[order[i]][j];
        }
    }
}

/* Fills the circle of a flange pose, but for its number of parts. */
static void circle_of(const Arm *arm, const double *R, const double *p, double low, double high, Circle *circle)
{
    Shape shape;
    shape_of(arm, R, p, low, high, &shape);
    circle->h[0] = 0.5 * (high - low);
    circle->h[1] = PI / (double)circle->parts;
    corners_of(arm, R, p, &shape, circle->parts, circle->corner);
    bends_of(arm, &shape, circle->parts, circle->bends);
    spans_of(circle->parts, circle->h, circle->corner, circle->bends, circle->span);
}

/* Returns whether there is memory for both. */
static int made(int64_t parts, Circle circle[2])
{
    int all = 1;
    for (int end = 0; end < 2; end++) {
        const size_t n = (size_t)parts;
        circle[end] = (Circle){.parts = parts,
                               .corner = malloc(sizeof(double) * 2 * n * JOINTS),
                               .bends = malloc(sizeof(Bends) * n),
                               .span = malloc(sizeof(Span) * n * JOINTS),
                               .needed = malloc(n)};
        all &= circle[end].corner && circle[end].bends && circle[end].span && circle[end].needed;
    }
    return all;
}

/* Cells of a flange pose, R (9) and p (3) in the carried frame at platform angle zero: fine ones, `finer` times `parts`
   around the circle, enclosed together by platform cell, branch, part of the circle and turn. The line leads to
   `target` (3); without steps of its law it takes no time. Returns 0, or 1 without memory; cells->count may exceed
   cells->most, and then is what is needed. */
int posture_cells(const Arm *arm, const double *R, const double *p, const double *target, const LineLaw *law,
                  const Intervals *intervals, int64_t parts, int64_t finer, int64_t free_last, Cells *cells)
{
    const int64_t fine = parts * finer;
    int64_t most = 1, begin = 0;
    for (int64_t i = 0; i < intervals->count; i++) {
        begin = i && intervals->cell[i] == intervals->cell[i - 1] ? begin : i;
        most = i - begin + 1 > most ? i - begin + 1 : most;
    }
    Circle circle[2];
    Box *box = malloc(sizeof(Box) * (size_t)(most * fine));
    double *line = malloc(sizeof(double) * (size_t)parts);
    Group *group = malloc(sizeof(Group));
    int failed = !made(fine, circle) || !box || !line || !group;
    cells->count = 0;
    for (int64_t first = 0, past; !failed && first < intervals->count; first = past) {
        for (int64_t part = 0; part < parts; part++)
            line[part] = law->steps ? INFINITY : 0.0;
        for (past = first; past < intervals->count && intervals->cell[past] == intervals->cell[first]; past++) {
            const double low = intervals->low[past], high = intervals->high[past];
            circle_of(arm, R, p, low, high, circle);
            boxes_of(arm, (int)free_last, circle, box + (past - first) * fine);
            if (!law->steps)
                continue;
            circle_of(arm, R, target, low, high, circle + 1);
            for (int64_t k = 0; k < fine; k++)
                circle->needed[k] = some_branch(box + (past - first) * fine + k);
            failed |= lower_line_times(law, (int)free_last, circle, circle + 1, finer, intervals->line[past], line);
        }
        for (int branch = 0; branch < BRANCHES; branch++)
            for (int64_t part = 0; part < parts; part++) {
                group->count = 0;
                for (int64_t i = first; i < past; i++)
                    for (int64_t k = finer * part; k < finer * (part + 1); k++) {
                        const Box *own = box + (i - first) * fine + k;
                        double low[JOINTS + 1], high[JOINTS + 1];
                        low[JOINTS] = intervals->low[i];
                        high[JOINTS] = intervals->high[i];
                        if (is_possible(own, branch))
                            each_turn(group, own, branch, 0, low, high);
                    }
                emit(group, intervals->cell[first], branch, line[part], cells);
            }
    }
    for (int end = 0; end < 2; end++) {
        free(circle[end].corner);
        free(circle[end].bends);
        free(circle[end].span);
        free(circle[end].needed);
    }
    free(box);
    free(line);
    free(group);
    return failed;
}
