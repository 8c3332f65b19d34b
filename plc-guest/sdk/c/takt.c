/* What compilers call by themselves, and takt_logf. */
#include "takt.h"

#include <stdarg.h>

void *memcpy(void *restrict to, const void *restrict from, size_t bytes) {
    void *result = to;
    __asm__ volatile("rep movsb" : "+D"(to), "+S"(from), "+c"(bytes) : : "memory");
    return result;
}

void *memmove(void *to, const void *from, size_t bytes) {
    if ((uintptr_t)to - (uintptr_t)from >= bytes) return memcpy(to, from, bytes);
    /* The destination begins inside of the source: from the end on. */
    void *last = (char *)to + bytes - 1;
    from = (const char *)from + bytes - 1;
    __asm__ volatile("std\n\trep movsb\n\tcld" : "+D"(last), "+S"(from), "+c"(bytes) : : "memory");
    return to;
}

void *memset(void *to, int value, size_t bytes) {
    void *result = to;
    __asm__ volatile("rep stosb" : "+D"(to), "+c"(bytes) : "a"(value) : "memory");
    return result;
}

int memcmp(const void *a, const void *b, size_t bytes) {
    const volatile unsigned char *x = a, *y = b;
    for (size_t i = 0; i < bytes; i++)
        if (x[i] != y[i]) return x[i] - y[i];
    return 0;
}

/* The line of takt_logf in the making. */
struct line {
    char text[121];
    unsigned bytes;
};

static void put(struct line *line, char c) {
    if (line->bytes < sizeof line->text - 1) line->text[line->bytes++] = c;
}

/* What stands between % and the letter. */
struct conversion {
    unsigned width, digits;
    bool left, zeros;
};

/* A text of so many bytes, filled up to the width. The zeros come behind the sign. */
static void put_filled(struct line *line, struct conversion how, const char *text, unsigned bytes) {
    unsigned fill = how.width > bytes ? how.width - bytes : 0;
    if (how.zeros && bytes && *text == '-') {
        put(line, '-');
        text++, bytes--;
    }
    if (!how.left)
        for (unsigned i = 0; i < fill; i++) put(line, how.zeros ? '0' : ' ');
    for (unsigned i = 0; i < bytes; i++) put(line, text[i]);
    if (how.left)
        for (unsigned i = 0; i < fill; i++) put(line, ' ');
}

/* Digits of a number in front of `end`; gives the first one. */
static char *digits(char *end, uint64_t number, unsigned base, unsigned least) {
    for (unsigned i = 0; number || i < least; i++, number /= base)
        *--end = "0123456789abcdef"[number % base];
    return end;
}

static void put_integer(struct line *line, struct conversion how, uint64_t number, bool negative,
                        unsigned base) {
    char text[24], *end = text + sizeof text;
    char *first = digits(end, negative ? 0 - number : number, base, 1);
    if (negative) *--first = '-';
    put_filled(line, how, first, (unsigned)(end - first));
}

static void put_real(struct line *line, struct conversion how, double number) {
    char text[48], *end = text + sizeof text, *first = end;
    uint64_t bits;
    __asm__("movq %1, %0" : "=r"(bits) : "x"(number));
    bool negative = bits >> 63;
    if (negative) number = -number;
    if ((bits >> 52 & 0x7ff) == 0x7ff) {
        bool infinite = !(bits << 12);
        negative = negative && infinite;
        how.zeros = false;
        for (unsigned i = 3; i--;) *--first = (infinite ? "inf" : "nan")[i];
    } else {
        if (number >= 1e18) {
            unsigned exponent = 0;
            for (; number >= 10; number /= 10) exponent++;
            first = digits(first, exponent, 10, 2);
            *--first = '+';
            *--first = 'e';
        }
        uint64_t scale = 1, whole = (uint64_t)number;
        for (unsigned i = 0; i < how.digits; i++) scale *= 10;
        double rest = (number - (double)whole) * (double)scale;
        uint64_t part = (uint64_t)rest;
        /* Halves go to the even digit, as in printf. */
        uint64_t last = how.digits ? part : whole;
        if (rest - (double)part > 0.5 || (rest - (double)part == 0.5 && (last & 1))) part++;
        if (part == scale) {
            whole++;
            part = 0;
        }
        if (how.digits) {
            first = digits(first, part, 10, how.digits);
            *--first = '.';
        } else {
            whole += part;
        }
        first = digits(first, whole, 10, 1);
    }
    if (negative) *--first = '-';
    put_filled(line, how, first, (unsigned)(end - first));
}

static unsigned number_in(const char **format, unsigned most) {
    unsigned number = 0;
    for (; **format >= '0' && **format <= '9'; ++*format)
        number = number * 10 + (unsigned)(**format - '0') > most
                     ? most : number * 10 + (unsigned)(**format - '0');
    return number;
}

void takt_logf(const char *format, ...) {
    struct line line = { .bytes = 0 };
    va_list values;
    va_start(values, format);
    for (; *format; format++) {
        if (*format != '%') {
            put(&line, *format);
            continue;
        }
        const char *from = format++;
        struct conversion how = { .digits = 6 };
        for (; *format == '-' || *format == '0'; format++) {
            how.left |= *format == '-';
            how.zeros |= *format == '0';
        }
        how.zeros &= !how.left;
        how.width = number_in(&format, 60);
        if (*format == '.') {
            format++;
            how.digits = number_in(&format, 9);
        }
        unsigned longs = 0;
        for (; *format == 'l'; format++) longs++;
        if (*format == 'd' || *format == 'u' || *format == 'x') {
            uint64_t value = longs ? va_arg(values, uint64_t)
                             : *format == 'd' ? (uint64_t)(int64_t)va_arg(values, int)
                                              : va_arg(values, unsigned);
            bool negative = *format == 'd' && (int64_t)value < 0;
            put_integer(&line, how, value, negative, *format == 'x' ? 16 : 10);
        } else if (*format == 'f') {
            put_real(&line, how, va_arg(values, double));
        } else if (*format == 's') {
            const char *text = va_arg(values, const char *);
            unsigned bytes = 0;
            if (!text) text = "(null)";
            while (bytes < sizeof line.text && text[bytes]) bytes++;
            how.zeros = false;
            put_filled(&line, how, text, bytes);
        } else if (*format == 'c') {
            char text = (char)va_arg(values, int);
            how.zeros = false;
            put_filled(&line, how, &text, 1);
        } else if (*format == '%') {
            put(&line, '%');
        } else {
            /* Which value it would take is not known, so the others would not be those of their conversions. */
            while (*from) put(&line, *from++);
            break;
        }
    }
    va_end(values);
    line.text[line.bytes] = 0;
    takt_log(line.text);
}
