/* The functions of math.h that are exact and small. All are weak: a library that has them, too, goes before. Their results
 * are the same on every processor. */
#include <stdint.h>

#define MATH __attribute__((weak))

typedef union {
    double number;
    uint64_t bits;
} parts;

static const uint64_t SIGN = (uint64_t)1 << 63, LEADING = (uint64_t)1 << 52;

MATH double sqrt(double x) {
    __asm__("sqrtsd %1, %0" : "=x"(x) : "x"(x));
    return x;
}

MATH double copysign(double x, double sign) {
    parts a = { x }, b = { sign };
    a.bits = (a.bits & ~SIGN) | (b.bits & SIGN);
    return a.number;
}

MATH double fabs(double x) { return copysign(x, 1); }

/* From 2^52 on there are no fractions, and neither in infinities and what is no number. */
static int is_whole(double x) { return !(fabs(x) < 4503599627370496.0); }

MATH double trunc(double x) { return is_whole(x) ? x : copysign((double)(int64_t)x, x); }

MATH double floor(double x) {
    double whole = trunc(x);
    return whole > x ? copysign(whole - 1, x) : whole;
}

MATH double ceil(double x) {
    double whole = trunc(x);
    return whole < x ? copysign(whole + 1, x) : whole;
}

/* Halves away from zero. The difference is exact; x + 0.5 would not be. */
MATH double round(double x) {
    double whole = trunc(x);
    return fabs(x - whole) >= 0.5 && !is_whole(x) ? whole + copysign(1, x) : whole;
}

MATH double fmin(double x, double y) { return x < y || y != y ? x : y; }
MATH double fmax(double x, double y) { return x > y || y != y ? x : y; }

/* The 53 bits of a number that is neither zero nor infinite, and the exponent that belongs to them. */
static uint64_t significand(parts x, int *exponent) {
    uint64_t bits = x.bits & (LEADING - 1);
    *exponent = (int)(x.bits >> 52 & 0x7ff);
    if (*exponent) return bits | LEADING;
    for (*exponent = 1; !(bits & LEADING); --*exponent) bits <<= 1;
    return bits;
}

/* Division as on paper: one subtraction for each bit between the exponents, up to 2,098. The rest is exact. */
MATH double fmod(double x, double y) {
    parts a = { x }, b = { y }, rest;
    uint64_t sign = a.bits & SIGN;
    a.bits &= ~SIGN;
    b.bits &= ~SIGN;
    if (x != x || y != y || a.bits >> 52 == 0x7ff || !b.bits) return (x * y) / (x * y);
    if (a.bits < b.bits) return x;
    int from, to;
    uint64_t number = significand(a, &from), divisor = significand(b, &to);
    for (;; from--) {
        if (number >= divisor) number -= divisor;
        if (from == to || !number) break;
        number <<= 1;
    }
    if (!number) {
        rest.bits = 0;
    } else {
        for (; !(number & LEADING); from--) number <<= 1;
        rest.bits = from > 0 ? (number - LEADING) | (uint64_t)from << 52 : number >> (1 - from);
    }
    rest.bits |= sign;
    return rest.number;
}

MATH float sqrtf(float x) {
    __asm__("sqrtss %1, %0" : "=x"(x) : "x"(x));
    return x;
}

/* Each number of 32 bits is one of 64 bits, and so is each of these results one of 32 bits. */
MATH float copysignf(float x, float sign) { return (float)copysign(x, sign); }
MATH float fabsf(float x) { return (float)fabs(x); }
MATH float truncf(float x) { return (float)trunc(x); }
MATH float floorf(float x) { return (float)floor(x); }
MATH float ceilf(float x) { return (float)ceil(x); }
MATH float roundf(float x) { return (float)round(x); }
MATH float fminf(float x, float y) { return x < y || y != y ? x : y; }
MATH float fmaxf(float x, float y) { return x > y || y != y ? x : y; }
MATH float fmodf(float x, float y) { return (float)fmod(x, y); }
