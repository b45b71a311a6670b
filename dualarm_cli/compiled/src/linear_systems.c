/* Small dense systems, stack by stack: elimination, one-sided Jacobi rotations, zeros of polynomials. */

#include <math.h>
#include <stdint.h>

enum { SWEEPS = 60, ROUNDS = 200 };

/* Solves (n, n) X = (n, m) in place by elimination with the largest pivot of each column; the determinant, or 0. */
static double eliminate(int64_t n, int64_t m, double *a, double *x) {
    double determinant = 1.0;
    for (int64_t c = 0; c < n; c++) {
        int64_t best = c;
        for (int64_t r = c + 1; r < n; r++)
            if (fabs(a[r * n + c]) > fabs(a[best * n + c])) best = r;
        double pivot = a[best * n + c];
        determinant *= best == c ? pivot : -pivot;
        if (pivot == 0.0) return 0.0;
        if (best != c) {
            for (int64_t j = 0; j < n; j++) {
                double held = a[c * n + j];
                a[c * n + j] = a[best * n + j], a[best * n + j] = held;
            }
            for (int64_t j = 0; j < m; j++) {
                double held = x[c * m + j];
                x[c * m + j] = x[best * m + j], x[best * m + j] = held;
            }
        }
        for (int64_t r = c + 1; r < n; r++) {
            double share = a[r * n + c] / pivot;
            if (share == 0.0) continue;
            for (int64_t j = c + 1; j < n; j++) a[r * n + j] -= share * a[c * n + j];
            for (int64_t j = 0; j < m; j++) x[r * m + j] -= share * x[c * m + j];
        }
    }
    for (int64_t c = n - 1; c >= 0; c--) {
        for (int64_t j = 0; j < m; j++) {
            for (int64_t k = c + 1; k < n; k++) x[c * m + j] -= a[c * n + k] * x[k * m + j];
            x[c * m + j] /= a[c * n + c];
        }
    }
    return determinant;
}

/* Solves `count` systems in place: matrices (n, n) are used up, right sides (n, m) become solutions. */
void dualarm_solve(int64_t count, int64_t n, int64_t m, double *a, double *x, double *determinant) {
    for (int64_t s = 0; s < count; s++)
        determinant[s] = eliminate(n, m, a + s * n * n, x + s * n * m);
}

/* Turns the rows of (n, m) by rotations, which V (n, n) collects, until all are orthogonal (Hestenes 1958). */
static void orthogonalise(int64_t n, int64_t m, double *a, double *v) {
    double most = 0.0;
    for (int64_t i = 0; i < n * m; i++) most += a[i] * a[i];
    for (int sweep = 0, turned = 1; sweep < SWEEPS && turned; sweep++) {
        turned = 0;
        for (int64_t p = 0; p + 1 < n; p++) {
            for (int64_t q = p + 1; q < n; q++) {
                double pp = 0.0, qq = 0.0, pq = 0.0;
                for (int64_t j = 0; j < m; j++) {
                    pp += a[p * m + j] * a[p * m + j];
                    qq += a[q * m + j] * a[q * m + j];
                    pq += a[p * m + j] * a[q * m + j];
                }
                /* Rows within rounding of zero have no direction left to turn. */
                if (fabs(pq) <= 1e-15 * sqrt(pp * qq) || pp <= 1e-32 * most || qq <= 1e-32 * most) continue;
                double half = (qq - pp) / (2.0 * pq);
                double t = (half >= 0.0 ? 1.0 : -1.0) / (fabs(half) + sqrt(1.0 + half * half));
                double c = 1.0 / sqrt(1.0 + t * t), s = c * t;
                turned = 1;
                for (int64_t j = 0; j < m; j++) {
                    double one = a[p * m + j], other = a[q * m + j];
                    a[p * m + j] = c * one - s * other, a[q * m + j] = s * one + c * other;
                }
                for (int64_t j = 0; j < n; j++) {
                    double one = v[p * n + j], other = v[q * n + j];
                    v[p * n + j] = c * one - s * other, v[q * n + j] = s * one + c * other;
                }
            }
        }
    }
}

/* Orthogonalises the rows of `count` matrices (n, m) in place; `v` (n, n) begins as unit matrices. */
void dualarm_orthogonalise(int64_t count, int64_t n, int64_t m, double *a, double *v) {
    for (int64_t s = 0; s < count; s++) orthogonalise(n, m, a + s * n * m, v + s * n * n);
}

/* All zeros of one polynomial t^n + c[n-1] t^(n-1) + ... + c[0], from one another's distances (Aberth 1973). */
static void zeros(int64_t n, const double *c, double *re, double *im) {
    double size = 0.0;
    for (int64_t k = 0; k < n; k++) size = fmax(size, fabs(c[k]));
    double radius = fmin(1.0 + size, 2.0 * pow(fmax(size, 1e-300), 1.0 / (double)n));
    for (int64_t i = 0; i < n; i++) {
        double angle = 6.283185307179586 * ((double)i + 0.25) / (double)n;
        re[i] = radius * cos(angle), im[i] = radius * sin(angle);
    }
    for (int round = 0, moved = 1; round < ROUNDS && moved; round++) {
        moved = 0;
        for (int64_t i = 0; i < n; i++) {
            double x = re[i], y = im[i], fr = 1.0, fi = 0.0, dr = 0.0, di = 0.0, sr = 0.0, si = 0.0;
            for (int64_t k = n - 1; k >= 0; k--) {
                double slope = dr * x - di * y + fr;
                di = dr * y + di * x + fi, dr = slope;
                double value = fr * x - fi * y + c[k];
                fi = fr * y + fi * x, fr = value;
            }
            for (int64_t k = 0; k < n; k++) {
                double ax = x - re[k], ay = y - im[k], away = ax * ax + ay * ay;
                if (k != i && away > 0.0) sr += ax / away, si -= ay / away;
            }
            /* The step is f / (f' - f sum), with the sum of the reciprocal distances to the others. */
            double br = dr - (fr * sr - fi * si), bi = di - (fr * si + fi * sr), below = br * br + bi * bi;
            if (below == 0.0) continue;
            double step_r = (fr * br + fi * bi) / below, step_i = (fi * br - fr * bi) / below;
            re[i] = x - step_r, im[i] = y - step_i;
            if (fabs(step_r) + fabs(step_i) > 4e-16 * (fabs(x) + fabs(y))) moved = 1;
        }
    }
}

/* Zeros of `count` monic polynomials of degree n, given by their other coefficients, lowest first. */
void dualarm_zeros(int64_t count, int64_t n, const double *coefficients, double *re, double *im) {
    for (int64_t s = 0; s < count; s++) zeros(n, coefficients + s * n, re + s * n, im + s * n);
}

/* Solves one banded system in place, without pivots: row r of `a` has columns r - low to r + high. */
void dualarm_solve_banded(int64_t n, int64_t low, int64_t high, int64_t m, double *a, double *x) {
    const int64_t width = low + high + 1;
    for (int64_t c = 0; c < n; c++) {
        const double *pivot = a + c * width + low;
        const int64_t right = high < n - 1 - c ? high : n - 1 - c;
        for (int64_t r = c + 1; r < n && r <= c + low; r++) {
            double *row = a + r * width + low - (r - c);
            double share = row[0] / pivot[0];
            for (int64_t j = 1; j <= right; j++) row[j] -= share * pivot[j];
            for (int64_t j = 0; j < m; j++) x[r * m + j] -= share * x[c * m + j];
        }
    }
    for (int64_t c = n - 1; c >= 0; c--) {
        const double *pivot = a + c * width + low;
        const int64_t right = high < n - 1 - c ? high : n - 1 - c;
        for (int64_t j = 0; j < m; j++) {
            for (int64_t k = 1; k <= right; k++) x[c * m + j] -= pivot[k] * x[(c + k) * m + j];
            x[c * m + j] /= pivot[0];
        }
    }
}
