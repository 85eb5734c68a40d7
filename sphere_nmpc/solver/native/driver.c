/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The iteration of levenberg_marquardt.py on the generated kernels, step for step; that file says
 * what and why, this one only how it is made cheap. No allocation: the caller brings the memory.
 */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

#define MIN_DAMPING 1e-12
#define MAX_DAMPING 1e12
#define BOUND_PASSES 4
#define ROW 8 /* 6 state components, a right-hand side, and one more to fill a register */

enum { CONVERGED, CAPPED, BUDGET, NOT_FINITE, ABANDONED };

#include "vectors.h"
#include "kernels.h"
#include "hold.h"
#include "expansion.h"
#include "step.h"

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* `winner` is the lowest index that has succeeded so far in a batch, or null. */
static void solve(hold *p, const int64_t *winner, int64_t index)
{
    room r;
    const double began = now();
    const int64_t size = 2 * p->intervals;
    double damping = p->initial_damping, growth = 2.0;
    int expanded = 0;
    prepare(p, &r);
    p->status = CAPPED;
    p->iterations = 0;
    p->kkt_residual = INFINITY;
    p->cost = evaluate(p, r.v, p->inputs, p->states, r.interval);
    if (!isfinite(p->cost))
        p->status = NOT_FINITE;
    while (p->status != NOT_FINITE) {
        if (!expanded) {
            expand(p, &r, r.v, p->inputs, p->states);
            expanded = 1;
            p->kkt_residual = projected_gradient(&r, size);
            if (p->kkt_residual <= p->gradient_tolerance || p->cost <= p->target_cost) {
                p->status = CONVERGED;
                break;
            }
        }
        if (p->iterations >= p->max_iterations)
            break;
        if (p->time_budget < INFINITY && now() - began > p->time_budget) {
            p->status = BUDGET;
            break;
        }
        if (winner && __atomic_load_n(winner, __ATOMIC_RELAXED) < index) {
            p->status = ABANDONED;
            break;
        }
        p->iterations++;
        double value = NAN;
        if (bounded_step(p, &r, damping, p->states)) {
            for (int64_t i = 0; i < size; i++)
                r.trial[i] = clip(r.v[i] + r.step[i], r.lower[i], r.upper[i]);
            value = evaluate(p, r.trial, r.inputs, r.states, r.interval);
        }
        const double decrease = p->cost - value;
        if (isfinite(value) && decrease > 0.0) {
            const double predicted = predicted_decrease(p, &r);
            const double gain = fmin(decrease / fmax(predicted, 1e-300), 1.0);
            const int small = decrease <= fmax(p->decrease_tolerance * p->cost, p->decrease_floor);
            damping *= fmax(1.0 / 3.0, 1.0 - pow(2.0 * gain - 1.0, 3.0));
            damping = fmax(damping, MIN_DAMPING);
            growth = 2.0;
            memcpy(r.v, r.trial, (size_t)size * sizeof *r.v);
            memcpy(p->inputs, r.inputs, (size_t)(size + 2) * sizeof *r.inputs);
            memcpy(p->states, r.states, (size_t)(6 * p->intervals + 6) * sizeof *r.states);
            p->cost = value;
            expanded = 0;
            if (small) {
                expand(p, &r, r.v, p->inputs, p->states);
                p->kkt_residual = projected_gradient(&r, size);
                p->status = CONVERGED;
                break;
            }
        } else {
            damping *= growth;
            growth *= 2.0;
            if (damping > MAX_DAMPING) {
                p->status = CONVERGED;
                break;
            }
        }
    }
    /* U (u / U) may differ from u in the last place: a bound is met exactly all the same. */
    for (int64_t i = 0; i < size; i++)
        p->inputs[i + 2] = clip(p->inputs[i + 2], p->lower[i], p->upper[i]);
    p->solve_time = now() - began;
}

void hold_solve(hold *p)
{
    solve(p, 0, 0);
}

/* For tests: cost, gradient (2 N), Hessian (2 N x 2 N) and sensitivities ((N + 1) x 6 x 2 N, by
 * scaled inputs) at the start. */
void hold_expand(hold *p, double *gradient, double *hessian, double *sensitivities)
{
    room r;
    const int64_t size = 2 * p->intervals, block = 6 * size;
    prepare(p, &r);
    p->cost = evaluate(p, r.v, p->inputs, p->states, r.interval);
    expand(p, &r, r.v, p->inputs, p->states);
    p->kkt_residual = projected_gradient(&r, size);
    memcpy(gradient, r.gradient, (size_t)size * sizeof *gradient);
    for (int64_t j = 0; j < size; j++) {
        memset(r.step, 0, (size_t)size * sizeof *r.step);
        r.step[j] = 1.0;
        for (int64_t i = 0; i < size; i++) {
            double sum;
            if (is_dense(p)) {
                sum = dense_product(&r, r.step, i, size);
            } else {
                sum = banded_product(&r, r.step, i, size);
                for (int l = 0; l < 6; l++)
                    sum += 2.0 * p->terminal_weight * r.rows[i * ROW + l] * r.rows[j * ROW + l];
            }
            hessian[i * size + j] = sum;
        }
    }
    memset(r.chain, 0, (size_t)block * sizeof *r.chain);
    memset(sensitivities, 0, (size_t)block * sizeof *sensitivities);
    for (int64_t m = 0; m < p->intervals; m++) {
        advance_chain(p, &r, m);
        memcpy(sensitivities + (m + 1) * block, r.chain, (size_t)block * sizeof *r.chain);
    }
}

typedef struct {
    int64_t next, winner;
} queue;

/* Work off the problems of a batch together with other threads. With `first_success` the lowest
 * index that reaches its target cost wins, whatever the threads do: every problem before it is
 * finished, and only those behind it are abandoned. */
void hold_solve_many(hold *problems, int64_t count, queue *shared, int64_t first_success,
                     double deadline, double *workspace)
{
    for (;;) {
        const int64_t i = __atomic_fetch_add(&shared->next, 1, __ATOMIC_RELAXED);
        if (i >= count)
            return;
        hold *p = problems + i;
        if (first_success && __atomic_load_n(&shared->winner, __ATOMIC_RELAXED) < i)
            continue;
        const double left = deadline - now();
        if (left <= 0.0)
            continue;
        p->workspace = workspace;
        p->time_budget = fmin(p->time_budget, left);
        solve(p, first_success ? &shared->winner : 0, i);
        if (first_success && p->cost <= p->target_cost && p->status == CONVERGED) {
            int64_t best = __atomic_load_n(&shared->winner, __ATOMIC_RELAXED);
            while (i < best
                   && !__atomic_compare_exchange_n(&shared->winner, &best, i, 0, __ATOMIC_RELAXED,
                                                   __ATOMIC_RELAXED)) {
            }
        }
    }
}

double hold_clock(void)
{
    return now();
}
