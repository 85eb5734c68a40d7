/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The damped Gauss-Newton step within the bounds, and the decrease of the cost that the model
 * predicts for it.
 */
/* Component i of D s, D without damping. */
static double banded_product(const workspace *w, const double *step, int64_t i, int64_t size)
{
    double sum = w->diagonal[i] * step[i];
    if (i >= 2)
        sum += w->subdiagonal[i] * step[i - 2];
    if (i + 2 < size)
        sum += w->subdiagonal[i + 2] * step[i + 2];
    return sum;
}

static double dense_product(const workspace *w, const double *step, int64_t i, int64_t size)
{
    double sum = 0.0;
    for (int64_t j = 0; j <= i; j++)
        sum += w->hessian[i * size + j] * step[j];
    for (int64_t j = i + 1; j < size; j++)
        sum += w->hessian[j * size + i] * step[j];
    return sum;
}

/* Factorise the lower triangle in place and solve; 0 where a pivot is not positive. */
static int cholesky_solve(double *a, int64_t size, int64_t stride, double *x)
{
    for (int64_t i = 0; i < size; i++) {
        double *row = a + i * stride;
        for (int64_t j = 0; j <= i; j++) {
            const double *other = a + j * stride;
            double sum = row[j];
            for (int64_t k = 0; k < j; k++)
                sum -= row[k] * other[k];
            if (j < i) {
                row[j] = sum * other[j];
            } else {
                if (!(sum > 0.0))
                    return 0;
                row[i] = 1.0 / sqrt(sum); /* the reciprocal of the pivot is what is used */
            }
        }
    }
    for (int64_t i = 0; i < size; i++) {
        for (int64_t k = 0; k < i; k++)
            x[i] -= a[i * stride + k] * x[k];
        x[i] *= a[i * stride + i];
    }
    for (int64_t i = size; i-- > 0;) {
        for (int64_t k = i + 1; k < size; k++)
            x[i] -= a[k * stride + i] * x[k];
        x[i] *= a[i * stride + i];
    }
    return 1;
}

/* Solve for the free components of the step with the others fixed; dense form. */
static int dense_step(workspace *w, double damping, int64_t size)
{
    int64_t count = 0;
    for (int64_t i = 0; i < size; i++) {
        if (!w->free[i])
            continue;
        int64_t j_count = 0;
        for (int64_t j = 0; j <= i; j++)
            if (w->free[j])
                w->factor[count * size + j_count++] = w->hessian[i * size + j];
        w->factor[count * size + count] += damping;
        count++;
    }
    for (int64_t i = 0; i < size; i++)
        if (w->free[i])
            w->step[i] = 0.0;
    count = 0;
    for (int64_t i = 0; i < size; i++)
        if (w->free[i])
            w->right[count++] = -(w->gradient[i] + dense_product(w, w->step, i, size));
    if (!cholesky_solve(w->factor, count, size, w->right))
        return 0;
    count = 0;
    for (int64_t i = 0; i < size; i++)
        if (w->free[i])
            w->step[i] = w->right[count++];
    return 1;
}

/* The same with H = 2 J^T J + D: solve with the bands, then correct by a 6 x 6 system
 * (Woodbury's formula). */
static int sparse_step(const problem *p, workspace *w, double damping, int64_t size)
{
    double small[END * END], error[END], *z = w->solved;
    for (int l = 0; l < END; l++)
        error[l] = state_residual(p, p->states, p->intervals, l);
    for (int64_t i = 0; i < size; i++) {
        if (w->free[i])
            w->step[i] = 0.0;
        else if (w->step[i] != 0.0)
            for (int l = 0; l < END; l++)
                error[l] += w->rows[i * ROW + l] * w->step[i];
    }
    for (int64_t i = 0; i < size; i++) {
        double *row = z + i * ROW;
        if (!w->free[i]) {
            memset(row, 0, ROW * sizeof *row);
            w->pivot[i] = 1.0;
            w->ratio[i] = 0.0;
            continue;
        }
        memcpy(row, w->rows + i * ROW, ROW * sizeof *row);
        row[END] = w->partial_gradient[i] + banded_product(w, w->step, i, size);
        const int coupled = i >= 2 && w->free[i - 2];
        const double off = coupled ? w->subdiagonal[i] : 0.0;
        w->pivot[i] = w->diagonal[i] + damping;
        w->ratio[i] = 0.0;
        if (off != 0.0) {
            w->ratio[i] = off / w->pivot[i - 2];
            w->pivot[i] -= w->ratio[i] * off;
            for (int l = 0; l < ROW; l++)
                row[l] -= w->ratio[i] * row[l - 2 * ROW];
        }
        if (!(w->pivot[i] > 0.0))
            return 0;
    }
    double sums[END][ROW] = {{0.0}};
    for (int64_t i = size; i-- > 0;) {
        double *row = z + i * ROW;
        const double inverse = 1.0 / w->pivot[i];
        for (int l = 0; l < ROW; l++)
            row[l] *= inverse;
        if (i + 2 < size && w->ratio[i + 2] != 0.0)
            for (int l = 0; l < ROW; l++)
                row[l] -= w->ratio[i + 2] * row[l + 2 * ROW];
        if (w->free[i])
            for (int k = 0; k < END; k++)
                for (int l = 0; l < ROW; l++)
                    sums[k][l] += w->rows[i * ROW + k] * row[l];
    }
    for (int k = 0; k < END; k++) {
        memcpy(small + END * k, sums[k], END * sizeof(double));
        small[(END + 1) * k] += 0.5;
        error[k] -= sums[k][END];
    }
    if (!cholesky_solve(small, END, END, error))
        return 0;
    for (int64_t i = 0; i < size; i++)
        if (w->free[i]) {
            double sum = z[i * ROW + END];
            for (int l = 0; l < END; l++)
                sum += z[i * ROW + l] * error[l];
            w->step[i] = -sum;
        }
    return 1;
}

/* Minimise the damped model within the bounds; 0 where the factorisation fails. */
static int bounded_step(const problem *p, workspace *w, double damping)
{
    const int64_t size = 2 * p->intervals;
    int any = 0;
    for (int64_t i = 0; i < size; i++) {
        const double g = w->gradient[i];
        const int at_bound = (w->v[i] <= w->lower[i] && g >= 0.0)
                            || (w->v[i] >= w->upper[i] && g <= 0.0);
        w->free[i] = !at_bound && w->lower[i] < w->upper[i];
        w->step[i] = 0.0;
        any |= w->free[i];
    }
    for (int pass = 0; pass < BOUND_PASSES && any; pass++) {
        int crossed = 0;
        if (!(is_dense(p) ? dense_step(w, damping, size) : sparse_step(p, w, damping, size)))
            return 0;
        any = 0;
        for (int64_t i = 0; i < size; i++) {
            if (!w->free[i])
                continue;
            const double next = w->v[i] + w->step[i];
            if (next < w->lower[i] || next > w->upper[i]) {
                w->step[i] = (next < w->lower[i] ? w->lower[i] : w->upper[i]) - w->v[i];
                w->free[i] = 0;
                crossed = 1;
            }
            any |= w->free[i];
        }
        if (!crossed)
            break;
    }
    for (int64_t i = 0; i < size; i++)
        w->step[i] = clip(w->v[i] + w->step[i], w->lower[i], w->upper[i]) - w->v[i];
    return 1;
}

static double predicted_decrease(const problem *p, const workspace *w)
{
    const int64_t size = 2 * p->intervals;
    double linear = 0.0, square = 0.0, end[ROW] = {0.0};
    for (int64_t i = 0; i < size; i++) {
        linear += w->gradient[i] * w->step[i];
        square += w->step[i] * (is_dense(p) ? dense_product(w, w->step, i, size)
                                            : banded_product(w, w->step, i, size));
    }
    if (!is_dense(p)) {
        for (int64_t i = 0; i < size; i++)
            for (int l = 0; l < ROW; l++)
                end[l] += w->rows[i * ROW + l] * w->step[i];
        for (int l = 0; l < ROW; l++)
            square += 2.0 * end[l] * end[l];
    }
    return -(linear + 0.5 * square);
}

/* Begin a solve; `foreseen`: whether the momentum at the end is known before the motion is. */
static void prepare(problem *p, workspace *w, int foreseen)
{
    divide(w, p->workspace, p->intervals);
    p->stretch = 1.0;
    p->iterations = 0;
    p->kkt_residual = INFINITY;
    w->duration = 0.0;
    for (int64_t m = 0; m < p->intervals; m++)
        w->duration += p->durations[m];
    if (foreseen && p->end != END_FREE)
        fix_end(p, w->duration);
    for (int64_t i = 0; i < 2 * p->intervals; i++) {
        w->lower[i] = p->lower[i] / p->input_scale;
        w->upper[i] = p->upper[i] / p->input_scale;
        w->v[i] = clip(p->start[i] / p->input_scale, w->lower[i], w->upper[i]);
    }
}

/* Make the trial the point of the solve. */
static void accept_trial(problem *p, workspace *w)
{
    const int64_t size = 2 * p->intervals;
    memcpy(w->v, w->trial, (size_t)size * sizeof *w->v);
    memcpy(p->inputs, w->inputs, (size_t)(size + 2) * sizeof *w->inputs);
    memcpy(p->states, w->states, (size_t)(STATE * (p->intervals + 1)) * sizeof *w->states);
}
