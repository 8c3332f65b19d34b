/*
 * The kernels of this folder in C, with the checks of bounds that Structured Text has. gcc may prove a check away, as the
 * compiler of Structured Text does.
 */
#include <stdint.h>
#include <string.h>

#define CHECK(index, count) \
    do { \
        if ((uint32_t)(index) >= (uint32_t)(count)) __builtin_trap(); \
    } while (0)

struct pi {
    double sp, pv, out, sum, last;
};

static struct pi bank[64];
static double pv[64];

static __attribute__((noinline)) void pi(struct pi *p)
{
    double e = p->sp - p->pv;
    double sum = p->sum + 0.5 * e * 0.001;
    sum = sum > -10.0 ? sum : -10.0;
    p->sum = sum < 10.0 ? sum : 10.0;
    double d = (p->pv - p->last) / 0.001;
    p->last = p->pv;
    double u = 2.0 * e + p->sum - 0.01 * d;
    if (u > 1.0)
        u = 1.0;
    else if (u < -1.0)
        u = -1.0;
    p->out = u;
}

void k_pid(void)
{
    for (int32_t i = 0; i < 64; i++) {
        CHECK(i, 64);
        bank[i].sp = 1.0;
        bank[i].pv = pv[i];
        pi(&bank[i]);
        pv[i] = pv[i] + bank[i].out * 0.001;
    }
}

static double x[10000], y[10000];

void k_filter(void)
{
    x[7] += 1.0;
    for (int32_t i = 2; i <= 9999; i++) {
        CHECK(i, 10000);
        CHECK(i - 1, 10000);
        CHECK(i - 2, 10000);
        y[i] = 0.2 * x[i] + 0.3 * x[i - 1] + 0.1 * x[i - 2] + 0.4 * y[i - 1];
    }
}

double a[32][32], b[32][32], c[32][32];

void k_matrix(void)
{
    a[1][2] += 1.0;
    b[2][3] = 2.0;
    for (int32_t i = 0; i < 32; i++)
        for (int32_t j = 0; j < 32; j++) {
            double s = 0.0;
            for (int32_t k = 0; k < 32; k++) {
                CHECK(i, 32);
                CHECK(j, 32);
                CHECK(k, 32);
                s += a[i][k] * b[k][j];
            }
            c[i][j] = s;
        }
}

static int32_t state[100], count[100];

void k_state_machine(void)
{
    for (int32_t round = 1; round <= 10; round++)
        for (int32_t i = 0; i < 100; i++) {
            CHECK(i, 100);
            switch (state[i]) {
            case 0:
                if (count[i] > 3) state[i] = 1;
                count[i]++;
                break;
            case 1:
                count[i]--;
                if (count[i] < 1) state[i] = 2;
                break;
            case 2:
                count[i] += 2;
                if (count[i] > 8) state[i] = 3;
                break;
            case 3:
                state[i] = 4;
                break;
            case 4:
                count[i] = 0;
                state[i] = 0;
                break;
            default:
                state[i] = 0;
            }
        }
}

char line[201];
static char item[21] = "pressure=12.5;";

static __attribute__((noinline)) uint32_t length(const char *text, uint32_t most)
{
    uint32_t n = 0;
    while (n < most && text[n]) n++;
    return n;
}

void k_text(void)
{
    line[0] = 0;
    for (int32_t i = 1; i <= 12; i++) {
        uint32_t n = length(line, 200), m = length(item, 20);
        if (n + m > 200) m = 200 - n;
        memcpy(line + n, item, m);
        line[n + m] = 0;
    }
}

static uint8_t data[1000];
uint32_t crc;

void k_crc(void)
{
    uint32_t value = 0xffffffff;
    data[5] = 0x5a;
    for (int32_t i = 0; i < 1000; i++) {
        CHECK(i, 1000);
        value ^= data[i];
        for (int32_t j = 1; j <= 8; j++)
            value = value & 1 ? value >> 1 ^ 0xedb88320 : value >> 1;
    }
    crc = value;
}
