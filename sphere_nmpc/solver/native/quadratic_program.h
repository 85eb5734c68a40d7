/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The program of one step of minimum_time.h: changes z of the knots and s of the duration that
 *
 *     minimise    g s + w sum_l |e_l + b_l s + (E z)_l| + r/2 sum_i c_i (z_i - a_i)^2
 *                 + 1/2 sum_i f_i ((change_i (1 - s) + z_i - z_(i-2))^2 + change_i^2 s)
 *     subject to  down <= z <= up,  s_down <= s <= s_up,
 *                 |change_i + z_i - z_(i-2)| <= limit_i (1 + s),
 *
 * by Mehrotra's primal-dual interior-point method (SIAM Journal on Optimization 2, 1992). Each
 * absolute value is the sum of an excess and a shortfall, both positive: their multipliers are
 * w - n_l and w + n_l, n_l being that of the row, which takes the excess and the shortfall out of
 * the equations. What remains is tridiagonal for each rotor, ROW rows and s. The last sum, which is
 * left out where all f are 0, is sum_i f_i/2 (change_i + z_i - z_(i-2))^2 / (1 + s) to second order.
 *
 * The inequalities are in groups of size + PAD: upper and lower bounds, accelerations upwards and
 * downwards. The PAD last ones of a group are none: their slack is 1, all else of them 0. Then
 * follow the bounds of s, the excesses and the shortfalls.
 */
#define SPAN (ROW + 1) /* rows and s */
#define PAD 2 /* knots of a rotor are this far apart */
#define PROGRAM_PASSES 40
#define TO_BOUNDARY 0.995 /* share of the way to the nearest constraint that a pass goes */
#define LEAST_SLACK 1e-2 /* at the start */
#define FIXED 1e12 /* weight of a knot that is fixed */

typedef struct {
    int64_t size, group, own, count; /* of z; of a group; inequalities before the excesses; all */
    const double *rows; /* size x ROW: E transposed, 0 for fixed knots */
    double *down, *up, *change, *limit, *metric, *pull, *effort; /* size + PAD: c, a, f the last */
    const uint8_t *free; /* size: 0 for fixed knots */
    int has_effort; /* whether f is not 0 */
    double e[ROW], b[ROW], g, w, r, s_down, s_up, tolerance;
    double *z, s; /* result */
    double *slack, *multiplier, *d_slack, *d_multiplier; /* count */
    double *inverse, *weight, *target, *primal; /* count: 1 / slack, multiplier / slack */
    double *gradient, *dz, *diagonal, *ratio, *by_s, *solved_s; /* size + PAD, as is z */
    double *solved; /* size x ROW */
    double n[ROW], schur[SPAN * SPAN], row_residual[ROW], s_residual;
} program;

static int64_t program_size(int64_t size)
{
    const int64_t group = size + PAD, count = 4 * group + 2 + 2 * ROW;
    return 8 * count + 14 * (group + PAD) + group * ROW;
}

/* Divide memory of program_size(size) doubles, all of which is zero then. */
static void divide_program(program *q, double *memory, int64_t size)
{
    double **of_count[] = {&q->slack, &q->multiplier, &q->d_slack, &q->d_multiplier, &q->inverse,
                           &q->weight, &q->target, &q->primal};
    double **of_size[] = {&q->down, &q->up, &q->change, &q->limit, &q->metric, &q->pull, &q->effort,
                          &q->z, &q->gradient, &q->dz, &q->diagonal, &q->ratio, &q->by_s,
                          &q->solved_s};
    memset(memory, 0, (size_t)program_size(size) * sizeof *memory);
    q->size = size;
    q->group = size + PAD;
    q->own = 4 * q->group + 2;
    q->count = q->own + 2 * ROW;
    for (size_t i = 0; i < sizeof of_count / sizeof of_count[0]; i++, memory += q->count)
        *of_count[i] = memory;
    for (size_t i = 0; i < sizeof of_size / sizeof of_size[0]; i++, memory += q->group + PAD)
        *of_size[i] = memory + PAD;
    q->solved = memory;
}

/* Left sides of the inequalities; z has PAD zeros before it. */
static void left_sides(const program *q, const double *z, double s, double *out)
{
    const int64_t n = q->size;
    double *upper = out, *lower = out + q->group, *faster = lower + q->group;
    double *slower = faster + q->group;
    for (int64_t i = 0; i < n; i++) {
        const double step = z[i] - z[i - PAD], reach = q->limit[i] * s;
        upper[i] = z[i];
        lower[i] = -z[i];
        faster[i] = step - reach;
        slower[i] = -step - reach;
    }
    out[q->own - 2] = s;
    out[q->own - 1] = -s;
}

/* Product of the transposed left sides with `y`, added to `z`; returns that of s. */
static double add_weighted_sides(const program *q, const double *y, double *z)
{
    const int64_t n = q->size;
    const double *upper = y, *lower = y + q->group, *faster = lower + q->group;
    const double *slower = faster + q->group;
    double sum = y[q->own - 2] - y[q->own - 1];
    for (int64_t i = 0; i < n; i++) {
        z[i] += upper[i] - lower[i] + faster[i] - slower[i] - faster[i + PAD] + slower[i + PAD];
        sum -= q->limit[i] * (faster[i] + slower[i]);
    }
    return sum;
}

static void right_sides(const program *q, double *out)
{
    double *upper = out, *lower = out + q->group, *faster = lower + q->group;
    double *slower = faster + q->group;
    for (int64_t i = 0; i < q->size; i++) {
        upper[i] = q->up[i];
        lower[i] = -q->down[i];
        faster[i] = q->limit[i] - q->change[i];
        slower[i] = q->limit[i] + q->change[i];
    }
    out[q->own - 2] = q->s_up;
    out[q->own - 1] = -q->s_down;
}

/* Set those of each group that are none. */
static void pad(const program *q, double *y, double value)
{
    for (int group = 1; group <= 4; group++)
        for (int k = 1; k <= PAD; k++)
            y[group * q->group - k] = value;
}

/* L D L^T of rows and s: the rows are positive definite and their complement in s is negative. */
static void factorise_small(double *a)
{
    for (int j = 0; j < SPAN; j++) {
        for (int k = 0; k < j; k++) {
            double sum = a[SPAN * j + k];
            for (int l = 0; l < k; l++)
                sum -= a[SPAN * j + l] * a[SPAN * k + l] * a[(SPAN + 1) * l];
            a[SPAN * j + k] = sum / a[(SPAN + 1) * k];
        }
        for (int l = 0; l < j; l++)
            a[(SPAN + 1) * j] -= a[SPAN * j + l] * a[SPAN * j + l] * a[(SPAN + 1) * l];
    }
}

static void solve_small(const double *a, double *x)
{
    for (int j = 0; j < SPAN; j++)
        for (int l = 0; l < j; l++)
            x[j] -= a[SPAN * j + l] * x[l];
    for (int j = 0; j < SPAN; j++)
        x[j] /= a[(SPAN + 1) * j];
    for (int j = SPAN; j-- > 0;)
        for (int l = j + 1; l < SPAN; l++)
            x[j] -= a[SPAN * l + j] * x[l];
}

/* Tridiagonal matrix of each rotor, from the weights of the inequalities, factorised; its product
 * with the rows, and the complement that rows and s remain with. */
static void factorise(program *q)
{
    const int64_t n = q->size;
    double with_s[ROW] = {0.0}, square = 0.0;
    for (int64_t i = 0; i < q->count; i++) {
        q->inverse[i] = 1.0 / q->slack[i];
        q->weight[i] = q->multiplier[i] * q->inverse[i];
    }
    const double *upper = q->weight, *lower = upper + q->group, *faster = lower + q->group;
    const double *slower = faster + q->group, *excess = q->weight + q->own;
    double by_s = q->weight[q->own - 2] + q->weight[q->own - 1];
    for (int64_t i = 0; i < n; i++) {
        const double here = faster[i] + slower[i], after = faster[i + PAD] + slower[i + PAD];
        q->diagonal[i] = q->r * q->metric[i] + upper[i] + lower[i] + here + after;
        q->by_s[i] = q->limit[i + PAD] * (faster[i + PAD] - slower[i + PAD])
                     - q->limit[i] * (faster[i] - slower[i]);
        by_s += q->limit[i] * q->limit[i] * here;
    }
    for (int64_t i = 0; q->has_effort && i < n; i++) {
        const double here = q->effort[i], after = q->effort[i + PAD];
        q->diagonal[i] += here + after;
        q->by_s[i] += after * q->change[i + PAD] - here * q->change[i];
        by_s += here * q->change[i] * q->change[i];
    }
    for (int64_t i = 0; i < n; i++)
        if (!q->free[i])
            q->diagonal[i] += FIXED;
    memcpy(q->solved, q->rows, (size_t)(n * ROW) * sizeof *q->solved);
    memcpy(q->solved_s, q->by_s, (size_t)n * sizeof *q->solved_s);
    for (int64_t i = 0; i < n; i++) {
        if (i >= PAD) {
            const double off = -(faster[i] + slower[i]) - q->effort[i];
            const double ratio = off * q->diagonal[i - PAD];
            double *row = q->solved + i * ROW;
            for (int l = 0; l < ROW; l++)
                row[l] -= ratio * row[l - PAD * ROW];
            q->solved_s[i] -= ratio * q->solved_s[i - PAD];
            q->diagonal[i] -= ratio * off;
            q->ratio[i] = ratio;
        }
        q->diagonal[i] = 1.0 / q->diagonal[i];
    }
    for (int64_t i = n; i-- > 0;) {
        double *row = q->solved + i * ROW;
        const double ratio = q->ratio[i + PAD], inverse = q->diagonal[i], *e = q->rows + i * ROW;
        for (int l = 0; l < ROW; l++)
            row[l] = inverse * row[l] - ratio * row[l + PAD * ROW];
        q->solved_s[i] = inverse * q->solved_s[i] - ratio * q->solved_s[i + PAD];
        for (int l = 0; l < ROW; l++)
            with_s[l] += e[l] * q->solved_s[i];
        square += q->by_s[i] * q->solved_s[i];
    }
    for (int k = 0; k < ROW; k++) {
        double sum[ROW] = {0.0}; /* one row at a time, which a compiler keeps in registers */
        for (int64_t i = 0; i < n; i++)
            for (int l = 0; l < ROW; l++)
                sum[l] += q->rows[i * ROW + k] * q->solved[i * ROW + l];
        memcpy(q->schur + SPAN * k, sum, sizeof sum);
        q->schur[(SPAN + 1) * k] += 1.0 / excess[k] + 1.0 / excess[ROW + k];
        q->schur[SPAN * ROW + k] = with_s[k] - q->b[k];
    }
    q->schur[SPAN * SPAN - 1] = square - by_s;
    factorise_small(q->schur);
}

/* Newton's direction towards products of slacks and multipliers that are less by `target`; returns
 * the direction of s, that of n in `dn`. */
static double direction(program *q, double *dn)
{
    const int64_t n = q->size, own = q->own;
    double x[SPAN];
    for (int64_t i = 0; i < n; i++)
        q->dz[i] = 0.0;
    for (int64_t i = 0; i < own; i++)
        q->d_multiplier[i] = q->weight[i] * q->primal[i] - q->inverse[i] * q->target[i];
    x[ROW] = q->s_residual + add_weighted_sides(q, q->d_multiplier, q->dz);
    for (int64_t i = 0; i < n; i++)
        q->dz[i] = -q->gradient[i] - q->dz[i] - q->ratio[i] * q->dz[i - PAD];
    for (int64_t i = n; i-- > 0;)
        q->dz[i] = q->diagonal[i] * q->dz[i] - q->ratio[i + PAD] * q->dz[i + PAD];
    for (int k = 0; k < ROW; k++) {
        const int64_t over = own + k, under = own + ROW + k;
        x[k] = q->row_residual[k] + q->target[over] / q->multiplier[over]
               - q->target[under] / q->multiplier[under];
    }
    for (int64_t i = 0; i < n; i++) {
        for (int k = 0; k < ROW; k++)
            x[k] += q->rows[i * ROW + k] * q->dz[i];
        x[ROW] += q->by_s[i] * q->dz[i];
    }
    solve_small(q->schur, x);
    for (int64_t i = 0; i < n; i++) {
        double sum = q->dz[i] - q->solved_s[i] * x[ROW];
        for (int l = 0; l < ROW; l++)
            sum -= q->solved[i * ROW + l] * x[l];
        q->dz[i] = sum;
    }
    left_sides(q, q->dz, x[ROW], q->d_slack);
    for (int64_t i = 0; i < own; i++) {
        q->d_slack[i] = -q->primal[i] - q->d_slack[i];
        q->d_multiplier[i] = -q->inverse[i] * q->target[i] - q->weight[i] * q->d_slack[i];
    }
    for (int k = 0; k < ROW; k++) {
        dn[k] = x[k];
        for (int sign = 0; sign < 2; sign++) {
            const int64_t i = own + sign * ROW + k;
            q->d_multiplier[i] = sign ? dn[k] : -dn[k];
            q->d_slack[i] = -(q->target[i] + q->slack[i] * q->d_multiplier[i]) / q->multiplier[i];
        }
    }
    return x[ROW];
}

/* Largest step along `d`, at most 1, for which `x` stays positive. */
static double largest_step(const double *x, const double *d, int64_t count)
{
    double rates[4] = {1.0, 1.0, 1.0, 1.0}; /* of which a compiler makes one register */
    int64_t i = 0;
    for (; i + 4 <= count; i += 4)
        for (int k = 0; k < 4; k++) {
            const double rate = -d[i + k] / x[i + k];
            rates[k] = rate > rates[k] ? rate : rates[k];
        }
    for (; i < count; i++)
        rates[0] = fmax(rates[0], -d[i] / x[i]);
    return 1.0 / fmax(fmax(rates[0], rates[1]), fmax(rates[2], rates[3]));
}

/* Add the derivatives of the effort to the gradient and to that of s. */
static void add_effort(program *q)
{
    for (int64_t i = 0; i < q->size; i++) {
        const double change = q->change[i];
        const double slope = q->effort[i] * (change * (1.0 - q->s) + q->z[i] - q->z[i - PAD]);
        q->gradient[i] += slope;
        if (i >= PAD)
            q->gradient[i - PAD] -= slope;
        q->s_residual += change * (0.5 * q->effort[i] * change - slope);
    }
}

/* Residuals of the conditions of optimality; returns the largest one. */
static double residuals(program *q)
{
    const int64_t n = q->size, own = q->own;
    double largest = 0.0;
    left_sides(q, q->z, q->s, q->primal);
    right_sides(q, q->inverse);
    for (int64_t i = 0; i < own; i++)
        q->primal[i] += q->slack[i] - q->inverse[i];
    pad(q, q->primal, 0.0);
    for (int k = 0; k < ROW; k++)
        q->row_residual[k] = q->e[k] + q->b[k] * q->s - q->slack[own + k] + q->slack[own + ROW + k];
    for (int64_t i = 0; i < n; i++) {
        double sum = q->r * q->metric[i] * (q->z[i] - q->pull[i]);
        if (!q->free[i])
            sum += FIXED * q->z[i];
        for (int k = 0; k < ROW; k++) {
            sum += q->rows[i * ROW + k] * q->n[k];
            q->row_residual[k] += q->rows[i * ROW + k] * q->z[i];
        }
        q->gradient[i] = sum;
    }
    q->s_residual = q->g + add_weighted_sides(q, q->multiplier, q->gradient);
    for (int k = 0; k < ROW; k++)
        q->s_residual += q->b[k] * q->n[k];
    if (q->has_effort)
        add_effort(q);
    for (int64_t i = 0; i < own; i++)
        largest = fmax(largest, fabs(q->primal[i]));
    for (int64_t i = 0; i < n; i++)
        largest = fmax(largest, 1e-2 * fabs(q->gradient[i]));
    for (int k = 0; k < ROW; k++)
        largest = fmax(largest, fabs(q->row_residual[k]));
    return fmax(largest, 1e-2 * fabs(q->s_residual));
}

/* Begin at z = 0 and s = 0. */
static void begin(program *q)
{
    const double start = 10.0 * q->g / (double)q->count;
    memset(q->z, 0, (size_t)q->size * sizeof *q->z);
    memset(q->n, 0, sizeof q->n);
    q->s = 0.0;
    right_sides(q, q->slack);
    for (int64_t i = 0; i < q->own; i++) {
        q->slack[i] = fmax(q->slack[i], LEAST_SLACK);
        q->multiplier[i] = start / fmax(q->slack[i], 0.1);
    }
    pad(q, q->slack, 1.0);
    pad(q, q->multiplier, 0.0);
    pad(q, q->d_slack, 0.0);
    for (int k = 0; k < ROW; k++) {
        q->slack[q->own + k] = fmax(q->e[k], 0.0) + LEAST_SLACK;
        q->slack[q->own + ROW + k] = fmax(-q->e[k], 0.0) + LEAST_SLACK;
        q->multiplier[q->own + k] = q->multiplier[q->own + ROW + k] = q->w;
    }
}

/* Solve; returns the passes, or -1 where a number is not finite. */
static int solve_program(program *q)
{
    const int64_t n = q->size, count = q->count;
    begin(q);
    for (int pass = 0; pass < PROGRAM_PASSES; pass++) {
        double gap = 0.0, after = 0.0, dn[ROW];
        const double largest = residuals(q);
        for (int64_t i = 0; i < count; i++) {
            q->target[i] = q->slack[i] * q->multiplier[i];
            gap += q->target[i];
        }
        if (!isfinite(gap) || !isfinite(largest))
            return -1;
        if (gap < q->tolerance && largest < 1e-8)
            return pass;
        factorise(q);
        direction(q, dn);
        double forward = largest_step(q->slack, q->d_slack, count);
        double dual = largest_step(q->multiplier, q->d_multiplier, count);
        for (int64_t i = 0; i < count; i++)
            after += (q->slack[i] + forward * q->d_slack[i])
                     * (q->multiplier[i] + dual * q->d_multiplier[i]);
        const double share = after / gap, centre = share * share * share * gap / (double)count;
        for (int64_t i = 0; i < count; i++)
            q->target[i] += q->d_slack[i] * q->d_multiplier[i] - centre;
        pad(q, q->target, 0.0);
        const double ds = direction(q, dn);
        forward = fmin(1.0, TO_BOUNDARY * largest_step(q->slack, q->d_slack, count));
        dual = fmin(1.0, TO_BOUNDARY * largest_step(q->multiplier, q->d_multiplier, count));
        for (int64_t i = 0; i < n; i++)
            q->z[i] += forward * q->dz[i];
        q->s += forward * ds;
        for (int k = 0; k < ROW; k++)
            q->n[k] += dual * dn[k];
        for (int64_t i = 0; i < count; i++) {
            q->slack[i] += forward * q->d_slack[i];
            q->multiplier[i] += dual * q->d_multiplier[i];
        }
    }
    return PROGRAM_PASSES;
}
