/* Least times of lines from cells of postures: `bound/cells.py` explains them.

   The circle at the target is halved again and again, down to its parts, and what a joint does over a half is enclosed
   by a span. Only parts that spans do not exclude are looked at closely, together with the part where the line begins:
   all differences of the arm angle between p - k and p + 1 - k parts, cut into halves as well. */

#include <math.h>
#include <stdlib.h>

#include "posture_lines.h"

/* Differences within a part are cut in halves so often. */
enum { CUTS = 4 };

/* A joint over one part where the line begins, or over a part at the target and the next: at all corners, for both ends
   of the interval of the platform angle. */
typedef struct {
    double at[2][3];
    Range second[DIRECTIONS];
    int smooth;
} Course;

/* Parts of the circle at the target, from `begin` on. */
typedef struct {
    int64_t begin, count, child; /* index of the first of two halves, 0 for a single part */
    Span span[JOINTS];
} Half;

static double time_of(const LineLaw *law, int joint, double way)
{
    const double step = way * law->per_step;
    const int64_t last = law->steps - 1, n = step < (double)last ? (int64_t)step : last;
    return law->time[joint * law->steps + n];
}

static double near_to(double angle, double to)
{
    return angle + TURN * nearbyint((to - angle) / TURN);
}

/* How far all numbers of a range are from whole turns at least. */
static double off_turns(double low, double high)
{
    if (!(high - low < TURN))
        return 0.0;
    const double shift = TURN * nearbyint(0.5 * (low + high) / TURN);
    return fmax(fmax(low - shift, shift - high), 0.0);
}

static Range hull(Range a, Range b)
{
    const double low = fmin(a.middle - a.radius, b.middle - b.radius);
    const double high = fmax(a.middle + a.radius, b.middle + b.radius);
    return (Range){0.5 * (low + high), 0.5 * (high - low)};
}

/* The courses of all joints, (parts, 7), over so many parts each. */
static void courses_of(const Circle *circle, int over, Course *course)
{
    const int64_t parts = circle->parts;
    for (int64_t k = 0; k < parts; k++)
        for (int joint = 0; joint < JOINTS; joint++) {
            Course *own = course + k * JOINTS + joint;
            const Bends *here = circle->bends + k, *next = circle->bends + (k + over - 1) % parts;
            own->smooth = here->smooth[joint] && next->smooth[joint];
            for (int d = 0; d < DIRECTIONS; d++)
                own->second[d] = hull(here->second[d][joint], next->second[d][joint]);
            for (int side = 0; side < 2; side++)
                for (int i = 0; i <= over; i++) {
                    const double angle = circle->corner[(side * parts + (k + i) % parts) * JOINTS + joint];
                    own->at[side][i] = i      ? near_to(angle, own->at[side][i - 1])
                                       : side ? near_to(angle, own->at[0][0])
                                              : angle;
                }
        }
}

static Span joined(Span a, Span b)
{
    if (!(a.low > -INFINITY && b.low > -INFINITY))
        return (Span){-INFINITY, INFINITY};
    const double shift = near_to(b.low, a.low) - b.low;
    return (Span){fmin(a.low, b.low + shift), fmax(a.high, b.high + shift)};
}

/* Fills halves of parts, the whole first; with each part goes the next one, as differences reach into it. Returns how
   many there are then. */
static int64_t halved(const Circle *circle, int64_t begin, int64_t count, Half *half, int64_t own, int64_t used)
{
    half[own] = (Half){.begin = begin, .count = count};
    if (count == 1) {
        for (int joint = 0; joint < JOINTS; joint++)
            half[own].span[joint] = joined(circle->span[begin * JOINTS + joint],
                                           circle->span[(begin + 1) % circle->parts * JOINTS + joint]);
        return used;
    }
    const int64_t child = used, first = count / 2;
    half[own].child = child;
    used = halved(circle, begin, first, half, child, used + 2);
    used = halved(circle, begin + first, count - first, half, child + 1, used);
    for (int joint = 0; joint < JOINTS; joint++)
        half[own].span[joint] = joined(half[child].span[joint], half[child + 1].span[joint]);
    return used;
}

/* How far a joint's positions at both ends of the line are apart at the corners, by the share of the differences of the
   arm angle, and how far below and above a straight course they may be. */
typedef struct {
    double left[CORNERS], slope[CORNERS], below, above;
} Gap;

static Gap gap_of(const double h[DIRECTIONS], const Course *from, const Course *to)
{
    Gap gap = {.below = 2.0 * ROUNDING, .above = 2.0 * ROUNDING};
    for (int side = 0; side < 2; side++)
        for (int i = 0; i < 2; i++) {
            gap.left[2 * side + i] = to->at[side][i] - from->at[side][i];
            gap.slope[2 * side + i] = to->at[side][i + 1] - to->at[side][i];
        }
    for (int d = 0; d < DIRECTIONS; d++) {
        const Range a = from->second[d], b = to->second[d];
        add_slack((Range){b.middle - a.middle, b.radius + a.radius}, h[d], &gap.below, &gap.above);
    }
    add_slack(to->second[1], h[1], &gap.below, &gap.above);
    if (!from->smooth || !to->smooth)
        gap.below = gap.above = INFINITY;
    return gap;
}

typedef struct {
    const LineLaw *law;
    const Course *from; /* where the line begins, of all joints */
    const Span *span;   /* the same */
    double h[DIRECTIONS];
    int free_last;
    /* To the part at the target that is looked at closely: gaps, and the times between spans of joint 4 and of triples,
       as they are and of the other branch. */
    Gap gap[JOINTS];
    double bend, plain[2], flipped[2];
    double best; /* the least time so far */
} Search;

/* The least time of a joint in a share of the differences of the arm angle. */
static double gap_time(const Search *search, int joint, double begin, double end)
{
    const Gap *gap = search->gap + joint;
    double low = INFINITY, high = -INFINITY;
    for (int c = 0; c < CORNERS; c++) {
        const double one = gap->left[c] + begin * gap->slope[c], other = gap->left[c] + end * gap->slope[c];
        const double less = one < other ? one : other, more = one < other ? other : one;
        low = less < low ? less : low;
        high = more > high ? more : high;
    }
    return time_of(search->law, joint, off_turns(low - gap->below, high + gap->above));
}

/* The least time of a joint between spans: with its other value at the target, or not. */
static double span_time(const Search *search, int joint, const Span *span, int flipped)
{
    const Span a = search->span[joint], b = span[joint];
    double low = b.low - a.high, high = b.high - a.low;
    if (flipped && joint % 2) {
        low = a.low + b.low;
        high = a.high + b.high;
    } else if (flipped) {
        low += PI;
        high += PI;
    }
    return time_of(search->law, joint, off_turns(low, high));
}

/* The least time of a triple between spans, of either branch at the target; not told above the best. */
static double triple_time(const Search *search, int triple, const Span *span, int flipped)
{
    double time = 0.0;
    for (int i = 0; i < 3 && time < search->best; i++)
        if (!search->free_last || JOINT[triple][i] != JOINTS - 1)
            time = fmax(time, span_time(search, JOINT[triple][i], span, flipped));
    return time;
}

/* Whether spans exclude lines that take less than the best time. */
static int excluded(const Search *search, const Span *span)
{
    if (span_time(search, 3, span, 0) >= search->best)
        return 1;
    for (int triple = 0; triple < 2; triple++)
        if (triple_time(search, triple, span, 0) >= search->best &&
            triple_time(search, triple, span, 1) >= search->best)
            return 1;
    return 0;
}

/* The least time in a share of the differences of the arm angle; not told above the best. */
static double share_time(const Search *search, double begin, double end)
{
    double time = fmax(search->bend, gap_time(search, 3, begin, end));
    for (int triple = 0; triple < 2 && time < search->best; triple++) {
        double plain = search->plain[triple];
        for (int i = 0; i < 3 && plain < search->flipped[triple]; i++)
            if (!search->free_last || JOINT[triple][i] != JOINTS - 1)
                plain = fmax(plain, gap_time(search, JOINT[triple][i], begin, end));
        time = fmax(time, fmin(plain, search->flipped[triple]));
    }
    return time;
}

/* Lowers the best time to that in a share of the differences, the more promising half first. */
static void lower_best(Search *search, double begin, double end, int cuts)
{
    const double middle = 0.5 * (begin + end);
    const double first = share_time(search, begin, middle), second = share_time(search, middle, end);
    for (int i = 0; i < 2; i++) {
        const int half = (first > second) ^ i;
        const double time = half ? second : first;
        if (time >= search->best)
            continue;
        if (cuts > 1)
            lower_best(search, half ? middle : begin, half ? end : middle, cuts - 1);
        else
            search->best = time;
    }
}

/* Lowers the best time to that of one part at the target. */
static void look_closely(Search *search, const Half *half, const Course *target)
{
    search->bend = span_time(search, 3, half->span, 0);
    for (int triple = 0; triple < 2; triple++) {
        search->plain[triple] = triple_time(search, triple, half->span, 0);
        search->flipped[triple] = triple_time(search, triple, half->span, 1);
    }
    for (int joint = 0; joint < JOINTS; joint++)
        search->gap[joint] = gap_of(search->h, search->from + joint, target + half->begin * JOINTS + joint);
    if (share_time(search, 0.0, 1.0) < search->best)
        lower_best(search, 0.0, 1.0, CUTS);
}

/* Lowers the best time to that of a half and all that it consists of. Returns the part that did, or `found`. */
static int64_t look(Search *search, const Half *half, int64_t own, const Course *target, int64_t found)
{
    const double before = search->best;
    if (excluded(search, half[own].span))
        return found;
    if (half[own].child) {
        found = look(search, half, half[own].child, target, found);
        return look(search, half, half[own].child + 1, target, found);
    }
    look_closely(search, half + own, target);
    return search->best < before ? half[own].begin : found;
}

int lower_line_times(const LineLaw *law, int free_last, const Circle *from, const Circle *to, int64_t finer,
                     double floor, double *line)
{
    const int64_t parts = from->parts;
    Course *course = malloc(sizeof(Course) * (size_t)(2 * parts * JOINTS)), *target = course + parts * JOINTS;
    Half *half = malloc(sizeof(Half) * (size_t)(2 * parts));
    int64_t *single = malloc(sizeof(int64_t) * (size_t)parts);
    if (!course || !half || !single) {
        free(course);
        free(half);
        free(single);
        return 1;
    }
    courses_of(from, 1, course);
    courses_of(to, 2, target);
    const int64_t halves = halved(to, 0, parts, half, 0, 1);
    for (int64_t i = 0; i < halves; i++)
        if (!half[i].child)
            single[half[i].begin] = i;
    Search search = {.law = law, .h = {from->h[0], from->h[1]}, .free_last = free_last};
    int64_t found = 0;
    for (int64_t k = 0; k < parts; k++) {
        /* The same difference as for the part before is a good one. */
        const int64_t guess = (found + 1) % parts;
        found = guess;
        if (!from->needed[k] || floor >= line[k / finer])
            continue;
        search.from = course + k * JOINTS;
        search.span = from->span + k * JOINTS;
        /* Not more than what the other value of joint 4 at the target would take. */
        search.best = fmin(line[k / finer], span_time(&search, 3, half->span, 1));
        look(&search, half, single[guess], target, guess);
        found = look(&search, half, 0, target, guess);
        line[k / finer] = fmax(search.best, floor);
    }
    free(course);
    free(half);
    free(single);
    return 0;
}
