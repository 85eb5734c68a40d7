/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * The damped Gauss-Newton step on the inputs that are free, and what the model expects of it.
 */
/* D step, without damping. */
static double banded_product(const room *r, const double *step, int64_t i, int64_t size)
{
    double sum = r->stiff[i] * step[i];
    if (i >= 2)
        sum += r->couple[i] * step[i - 2];
    if (i + 2 < size)
        sum += r->couple[i + 2] * step[i + 2];
    return sum;
}

static double dense_product(const room *r, const double *step, int64_t i, int64_t size)
{
    double sum = 0.0;
    for (int64_t j = 0; j <= i; j++)
        sum += r->hessian[i * size + j] * step[j];
    for (int64_t j = i + 1; j < size; j++)
        sum += r->hessian[j * size + i] * step[j];
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

/* Free components of the step, the others given; dense form. */
static int dense_step(room *r, double damping, int64_t size)
{
    int64_t count = 0;
    for (int64_t i = 0; i < size; i++) {
        if (!r->free[i])
            continue;
        int64_t j_count = 0;
        for (int64_t j = 0; j <= i; j++)
            if (r->free[j])
                r->factor[count * size + j_count++] = r->hessian[i * size + j];
        r->factor[count * size + count] += damping;
        count++;
    }
    for (int64_t i = 0; i < size; i++)
        if (r->free[i])
            r->step[i] = 0.0;
    count = 0;
    for (int64_t i = 0; i < size; i++)
        if (r->free[i])
            r->right[count++] = -(r->gradient[i] + dense_product(r, r->step, i, size));
    if (!cholesky_solve(r->factor, count, size, r->right))
        return 0;
    count = 0;
    for (int64_t i = 0; i < size; i++)
        if (r->free[i])
            r->step[i] = r->right[count++];
    return 1;
}

/* The same with H = 2 w J^T J + D: solve against the bands, correct by a 6 x 6 system. */
static int sparse_step(const hold *p, room *r, double damping, const double *x_end, int64_t size)
{
    double small[6 * 6], miss[6], *z = r->solved;
    for (int l = 0; l < 6; l++)
        miss[l] = x_end[l] - p->goal[l];
    for (int64_t i = 0; i < size; i++) {
        if (r->free[i])
            r->step[i] = 0.0;
        else if (r->step[i] != 0.0)
            for (int l = 0; l < 6; l++)
                miss[l] += r->rows[i * ROW + l] * r->step[i];
    }
    for (int64_t i = 0; i < size; i++) {
        double *row = z + i * ROW;
        if (!r->free[i]) {
            memset(row, 0, ROW * sizeof *row);
            r->pivot[i] = 1.0;
            r->ratio[i] = 0.0;
            continue;
        }
        memcpy(row, r->rows + i * ROW, ROW * sizeof *row);
        row[6] = r->extra[i] + banded_product(r, r->step, i, size);
        const int coupled = i >= 2 && r->free[i - 2];
        const double off = coupled ? r->couple[i] : 0.0;
        r->pivot[i] = r->stiff[i] + damping;
        r->ratio[i] = 0.0;
        if (off != 0.0) {
            r->ratio[i] = off / r->pivot[i - 2];
            r->pivot[i] -= r->ratio[i] * off;
            for (int l = 0; l < ROW; l++)
                row[l] -= r->ratio[i] * row[l - 2 * ROW];
        }
        if (!(r->pivot[i] > 0.0))
            return 0;
    }
    double sums[6][ROW] = {{0.0}};
    for (int64_t i = size; i-- > 0;) {
        double *row = z + i * ROW;
        const double inverse = 1.0 / r->pivot[i];
        for (int l = 0; l < ROW; l++)
            row[l] *= inverse;
        if (i + 2 < size && r->ratio[i + 2] != 0.0)
            for (int l = 0; l < ROW; l++)
                row[l] -= r->ratio[i + 2] * row[l + 2 * ROW];
        if (r->free[i])
            for (int k = 0; k < 6; k++)
                for (int l = 0; l < ROW; l++)
                    sums[k][l] += r->rows[i * ROW + k] * row[l];
    }
    for (int k = 0; k < 6; k++) {
        memcpy(small + 6 * k, sums[k], 6 * sizeof(double));
        small[7 * k] += 1.0 / (2.0 * p->terminal_weight);
        miss[k] -= sums[k][6];
    }
    if (!cholesky_solve(small, 6, 6, miss))
        return 0;
    for (int64_t i = 0; i < size; i++)
        if (r->free[i]) {
            double sum = z[i * ROW + 6];
            for (int l = 0; l < 6; l++)
                sum += z[i * ROW + l] * miss[l];
            r->step[i] = -sum;
        }
    return 1;
}

/* Minimise the damped model as far as the bounds allow; 0 where the factorisation fails. */
static int bounded_step(const hold *p, room *r, double damping, const double *states)
{
    const int64_t size = 2 * p->intervals;
    int any = 0;
    for (int64_t i = 0; i < size; i++) {
        const double g = r->gradient[i];
        const int pressed = (r->v[i] <= r->lower[i] && g >= 0.0)
                            || (r->v[i] >= r->upper[i] && g <= 0.0);
        r->free[i] = !pressed && r->lower[i] < r->upper[i];
        r->step[i] = 0.0;
        any |= r->free[i];
    }
    for (int pass = 0; pass < BOUND_PASSES && any; pass++) {
        int crossed = 0;
        if (!(is_dense(p) ? dense_step(r, damping, size)
                          : sparse_step(p, r, damping, states + 6 * p->intervals, size)))
            return 0;
        any = 0;
        for (int64_t i = 0; i < size; i++) {
            if (!r->free[i])
                continue;
            const double next = r->v[i] + r->step[i];
            if (next < r->lower[i] || next > r->upper[i]) {
                r->step[i] = (next < r->lower[i] ? r->lower[i] : r->upper[i]) - r->v[i];
                r->free[i] = 0;
                crossed = 1;
            }
            any |= r->free[i];
        }
        if (!crossed)
            break;
    }
    for (int64_t i = 0; i < size; i++)
        r->step[i] = clip(r->v[i] + r->step[i], r->lower[i], r->upper[i]) - r->v[i];
    return 1;
}

static double predicted_decrease(const hold *p, const room *r)
{
    const int64_t size = 2 * p->intervals;
    double linear = 0.0, square = 0.0, end[ROW] = {0.0};
    for (int64_t i = 0; i < size; i++) {
        linear += r->gradient[i] * r->step[i];
        square += r->step[i] * (is_dense(p) ? dense_product(r, r->step, i, size)
                                            : banded_product(r, r->step, i, size));
    }
    if (!is_dense(p)) {
        for (int64_t i = 0; i < size; i++)
            for (int l = 0; l < ROW; l++)
                end[l] += r->rows[i * ROW + l] * r->step[i];
        for (int l = 0; l < ROW; l++)
            square += 2.0 * p->terminal_weight * end[l] * end[l];
    }
    return -(linear + 0.5 * square);
}

static double projected_gradient(const room *r, int64_t size)
{
    double largest = 0.0;
    for (int64_t i = 0; i < size; i++) {
        const double v = r->v[i];
        const double move = fabs(clip(v - r->gradient[i], r->lower[i], r->upper[i]) - v);
        /* Written so that a NaN wins. */
        largest = move <= largest ? largest : move;
    }
    return largest;
}

static void prepare(const hold *p, room *r)
{
    lay_out(r, p->workspace, p->intervals);
    for (int64_t i = 0; i < 2 * p->intervals; i++) {
        r->lower[i] = p->lower[i] / p->input_scale;
        r->upper[i] = p->upper[i] / p->input_scale;
        r->v[i] = clip(p->start[i] / p->input_scale, r->lower[i], r->upper[i]);
    }
}
