/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Memory that a solve works in. The caller allocates it, hold_workspace(N) doubles.
 */
#define STATE 9 /* position, quaternion, momentum */
#define LARGEST_DERIVATIVE (STATE * sizeof(wide_tangent) / sizeof(double))

typedef struct {
    double *lower, *upper, *v, *trial, *step, *gradient; /* 2 N, scaled */
    double *diagonal, *subdiagonal; /* 2 N: diagonal and subdiagonal of D, without damping */
    double *partial_gradient; /* 2 N: gradient without the part of the terminal cost */
    double *pivot, *ratio, *right; /* 2 N */
    double *inputs, *states; /* of the trial */
    double *rows, *solved; /* 2 N x ROW: terminal Jacobian transposed; D^-1 of it */
    double *interval; /* N x LARGEST_DERIVATIVE: derivatives of each interval */
    double *chain; /* STATE x 2 N, only with a stage cost: sensitivities of one state */
    double *hessian, *factor; /* 2 N x 2 N, only with a stage cost */
    uint8_t *free; /* 2 N: 1 where the step is not fixed at a bound */
    double *program; /* of a minimum-time problem, see `divide_program` */
    double duration; /* of all intervals before they are stretched [s] */
} workspace;

#if defined(__SANITIZE_ADDRESS__)
#include <sanitizer/asan_interface.h>
/* The parts lie in one allocation: without a gap that must not be touched the sanitiser would not
 * find an index that runs from one part into the next. */
#define GAP 8
static void divide_at(const double *first, const double *end, const double *next)
{
    __asan_unpoison_memory_region(first, (size_t)((const char *)end - (const char *)first));
    __asan_poison_memory_region(end, (size_t)((const char *)next - (const char *)end));
}
#else
#define GAP 0
static void divide_at(const double *first, const double *end, const double *next)
{
    (void)first, (void)end, (void)next;
}
#endif

/* The next part of the memory at `base`, of whole cache lines; null where `base` is. */
static double *take(double *base, int64_t *used, int64_t count)
{
    const int64_t first = *used;
    *used += (count + 7) / 8 * 8 + GAP;
    if (!base)
        return NULL;
    divide_at(base + first, base + first + count, base + *used);
    return base + first;
}

/* Divide the memory at `base` among the parts and return how many doubles they take. With a null
 * pointer as `base` only that number is computed. */
static int64_t divide(workspace *w, double *base, int64_t n)
{
    int64_t used = 0;
    const int64_t m = 2 * n;
    double **vectors[] = {&w->lower, &w->upper, &w->v, &w->trial, &w->step, &w->gradient,
                          &w->diagonal, &w->subdiagonal, &w->partial_gradient,
                          &w->pivot, &w->ratio, &w->right};
    for (size_t i = 0; i < sizeof vectors / sizeof vectors[0]; i++)
        *vectors[i] = take(base, &used, m);
    w->inputs = take(base, &used, m + 2);
    w->states = take(base, &used, STATE * (n + 1));
    w->rows = take(base, &used, m * ROW);
    w->solved = take(base, &used, m * ROW);
    w->interval = take(base, &used, n * (int64_t)LARGEST_DERIVATIVE);
    w->chain = take(base, &used, STATE * m);
    w->hessian = take(base, &used, m * m);
    w->factor = take(base, &used, m * m);
    w->free = (uint8_t *)take(base, &used, m);
    w->program = take(base, &used, program_size(m));
    return used;
}

int64_t hold_workspace(int64_t intervals)
{
    workspace w;
    return divide(&w, NULL, intervals);
}
