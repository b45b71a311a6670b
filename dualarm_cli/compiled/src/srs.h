/* Spherical-revolute-spherical arms: shared by the files that solve them. Angles in rad, lengths in m. */

#ifndef SRS_H
#define SRS_H

#define PI 3.141592653589793
#define TURN (2.0 * PI)

enum { JOINTS = 7, BRANCHES = 8 };

/* An arm: numbers only, so that Python hands it over as one array. */
typedef struct {
    double B[9], C[9];                   /* frames of the canonical chain */
    double shoulder[3], flange_wrist[3]; /* shoulder in the base, wrist in the flange */
    double upper_arm, fore_arm;          /* lengths of the links */
    double sign[JOINTS], offset[JOINTS]; /* of the canonical joints */
    double lower[JOINTS], upper[JOINTS]; /* limits */
} Arm;

/* Joints as functions of the arm angle (`ArmPlane`, `ArmAngleCurves`), of one flange pose. */
typedef struct {
    double u[3], r[3], t[3], cos_a, sin_a, cos_f, sin_f, bend, R[9];
    double turning[4][2][3], bending[2][3];
    int reachable;
} Curves;

static inline double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Whether a branch takes the second of a joint's two values. */
static inline int flips(int joint, int branch)
{
    static const int flipped_by[JOINTS] = {2, 2, 6, 4, 5, 1, 1};
    const int bits = branch & flipped_by[joint];
    return ((bits >> 2) ^ (bits >> 1) ^ bits) & 1;
}

/* The curves of a flange pose in the base frame. */
void curves_of(const Arm *arm, const double *R, const double *p, Curves *curves);

/* Joints 1, 3, 5 and 7 at an arm angle, and theta2 and theta6, of the branch in which these two are not negative. */
void angles_at(const Arm *arm, const Curves *curves, double sine, double cosine, double q[4], double middle[2]);

#endif
