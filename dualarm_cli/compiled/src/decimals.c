/* Tables of decimal numbers as text. */

#include <math.h>
#include <stdint.h>

enum { PLACES = 9, UNIT = 1000000000 };

/* Writes the decimal digits of a number that is not negative, the first one not 0, and returns where they end. */
static char *whole_digits(char *out, int64_t value) {
    char reversed[20];
    int count = 0;
    do {
        reversed[count++] = (char)('0' + value % 10);
        value /= 10;
    } while (value > 0);
    while (count > 0)
        *out++ = reversed[--count];
    return out;
}

/* Writes a number of 1e-9 units without zeros at the end and without -0, and returns where it ends. */
static char *decimal(char *out, int64_t units) {
    if (units < 0) {
        *out++ = '-';
        units = -units;
    }
    int64_t part = units % UNIT;
    out = whole_digits(out, units / UNIT);
    if (part == 0)
        return out;
    int places = PLACES;
    for (; part % 10 == 0; places--)
        part /= 10;
    *out = '.';
    for (int k = places; k > 0; k--, part /= 10)
        out[k] = (char)('0' + part % 10);
    return out + 1 + places;
}

/* Writes m rows of n numbers as lines, with commas between them, and returns how many characters that makes.

   rows: below 1e6 in size. scale: 10 to the power of each column's digits after the point; rest: what makes 1e-9 units of
   these. text: room for 18 characters a number. */
int64_t table_text(const double *rows, const double *scale, const int64_t *rest, int64_t m, int64_t n, char *text) {
    char *out = text;
    for (int64_t i = 0; i < m; i++)
        for (int64_t j = 0; j < n; j++) {
            out = decimal(out, (int64_t)rint(rows[i * n + j] * scale[j]) * rest[j]);
            *out++ = j + 1 < n ? ',' : '\n';
        }
    return out - text;
}
