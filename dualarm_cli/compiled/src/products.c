/* Products of stacks of matrices. Each number is a sum in the order of its index, whatever the processor. */

#include <stdint.h>
#include <xmmintrin.h>

enum { BLOCK = 8, PACKED = 4096 };

typedef struct {
    double *at;
    int64_t stack, row, column; /* distances of neighbours, in numbers */
} Matrices;

static Matrices matrices(char *at, int64_t stack, const int64_t *step) {
    return (Matrices){(double *)at, stack / 8, step[0] / 8, step[1] / 8};
}

/* One product (n, k) (k, m); the second factor's columns are neighbours. */
static void multiply(int64_t n, int64_t k, int64_t m, Matrices a, const double *b, int64_t row, Matrices to) {
    for (int64_t i = 0; i < n; i++) {
        double *out = to.at + i * to.row;
        const double *factor = a.at + i * a.row;
        int64_t j = 0;
        for (; j + BLOCK <= m; j += BLOCK) {
            double sum[BLOCK] = {0.0};
            for (int64_t l = 0; l < k; l++) {
                const double *other = b + l * row + j;
                for (int c = 0; c < BLOCK; c++) sum[c] += factor[l * a.column] * other[c];
            }
            for (int c = 0; c < BLOCK; c++) out[(j + c) * to.column] = sum[c];
        }
        for (; j < m; j++) {
            double sum = 0.0;
            for (int64_t l = 0; l < k; l++) sum += factor[l * a.column] * b[l * row + j];
            out[j * to.column] = sum;
        }
    }
}

/* One product whose second factor lies in memory in any way. */
static void multiply_spread(int64_t n, int64_t k, int64_t m, Matrices a, Matrices b, Matrices out) {
    for (int64_t i = 0; i < n; i++) {
        for (int64_t j = 0; j < m; j++) {
            double sum = 0.0;
            for (int64_t l = 0; l < k; l++)
                sum += a.at[i * a.row + l * a.column] * b.at[l * b.row + j * b.column];
            out.at[i * out.row + j * out.column] = sum;
        }
    }
}

/* Loop of numpy's universal function (n, k), (k, m) -> (n, m) over stacks; it would warn of flags that are left. */
void dualarm_products(char **at, const int64_t *size, const int64_t *step, void *unused) {
    (void)unused;
    int64_t count = size[0], n = size[1], k = size[2], m = size[3];
    Matrices one = matrices(at[0], step[0], step + 3), other = matrices(at[1], step[1], step + 5);
    Matrices out = matrices(at[2], step[2], step + 7);
    double packed[PACKED];
    int again = 1;
    unsigned flags = _mm_getcsr();
    for (int64_t s = 0; s < count; s++, one.at += one.stack, other.at += other.stack, out.at += out.stack) {
        if (other.column == 1) {
            multiply(n, k, m, one, other.at, other.row, out);
        } else if (k * m <= PACKED && n > 1 && m > 1) {
            if (again || other.stack) {
                for (int64_t l = 0; l < k; l++)
                    for (int64_t j = 0; j < m; j++) packed[l * m + j] = other.at[l * other.row + j * other.column];
                again = 0;
            }
            multiply(n, k, m, one, packed, m, out);
        } else {
            multiply_spread(n, k, m, one, other, out);
        }
    }
    _mm_setcsr(flags);
}
