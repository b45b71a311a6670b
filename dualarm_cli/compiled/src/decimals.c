/* Formats tables of decimal numbers as text. */

#include <math.h>
#include <stdint.h>

enum { DECIMAL_PLACES = 9, UNITS_PER_ONE = 1000000000 };

/* Write a non-negative integer in decimal without leading zeros; return the end of the text. */
static char *write_integer(char *out, int64_t value) {
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

/* Write a number of 1e-9 units without trailing zeros and without -0; return the end of the text. */
static char *write_decimal(char *out, int64_t units) {
    if (units < 0) {
        *out++ = '-';
        units = -units;
    }
    int64_t fraction = units % UNITS_PER_ONE;
    out = write_integer(out, units / UNITS_PER_ONE);
    if (fraction == 0)
        return out;
    int places = DECIMAL_PLACES;
    for (; fraction % 10 == 0; places--)
        fraction /= 10;
    *out = '.';
    for (int k = places; k > 0; k--, fraction /= 10)
        out[k] = (char)('0' + fraction % 10);
    return out + 1 + places;
}

/* Write m rows of n numbers as comma-separated lines; return the number of characters.

   rows: numbers of magnitude below 1e6, (m, n).
   scale: 10 to the power of each column's decimal places, (n,).
   to_units: factor from the scaled column to units of 1e-9, (n,).
   text: buffer of 18 characters per number. */
int64_t table_text(const double *rows, const double *scale, const int64_t *to_units, int64_t m, int64_t n, char *text) {
    char *out = text;
    for (int64_t i = 0; i < m; i++)
        for (int64_t j = 0; j < n; j++) {
            out = write_decimal(out, (int64_t)rint(rows[i * n + j] * scale[j]) * to_units[j]);
            *out++ = j + 1 < n ? ',' : '\n';
        }
    return out - text;
}
