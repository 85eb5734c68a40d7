/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Motion along a first-order hold with the derivatives that an estimator needs: by the rotation
 * (3) and the momentum (3) at its start, the constants (4) and the torques (5).
 */
#define VARIED 15
#define FITTED (sizeof(fitted) / sizeof(double))

static fitted fitted_unit(int d)
{
    double lanes[FITTED] = {0.0};
    fitted t;
    lanes[d] = 1.0;
    memcpy(&t, lanes, sizeof t);
    return t;
}

/* Move `state` in place over the intervals between the knots of `inputs`. `derivative`, 8 x VARIED,
 * is that of the error of position, rotation and momentum at the end. */
void hold_propagate(int64_t intervals, double max_step, const double *constants,
                    const double *torques, const double *durations, const double *inputs,
                    double *state, double *derivative)
{
    double y[7], rows[9][FITTED] = {{0.0}};
    double *const q = y, *const end = derivative;
    fitted dy[7], dp[4], dtorques[5], dxy[2];
    memcpy(y, state + 2, sizeof y);
    /* q exp(r / 2) to first order. */
    const double turned[4][3] = {
        {-q[1], -q[2], -q[3]}, {q[0], -q[3], q[2]}, {q[3], q[0], -q[1]}, {-q[2], q[1], q[0]}};
    for (int k = 0; k < 4; k++) {
        for (int c = 0; c < 3; c++)
            rows[k][c] = 0.5 * turned[k][c];
        memcpy(dy + k, rows[k], sizeof *dy);
    }
    for (int k = 0; k < 3; k++)
        dy[4 + k] = fitted_unit(3 + k);
    for (int k = 0; k < 4; k++)
        dp[k] = fitted_unit(6 + k);
    for (int k = 0; k < 5; k++)
        dtorques[k] = fitted_unit(10 + k);
    memset(dxy, 0, sizeof dxy);
    for (int64_t m = 0; m < intervals; m++) {
        const double *u = inputs + 2 * m;
        const int64_t steps = steps_for(durations[m], max_step);
        const double h = durations[m] / (double)steps;
        for (int64_t i = 0; i < steps; i++) {
            const double a = (double)i / (double)steps, b = (double)(i + 1) / (double)steps;
            double here[2], there[2], moved[2], y_end[7];
            fitted d_moved[2], dy_end[7];
            inputs_at(u, a, here);
            inputs_at(u, b, there);
            fitted_step(y, here, there, h, constants, torques, dy, dp, dtorques, moved, y_end,
                        d_moved, dy_end);
            memcpy(y, y_end, sizeof y);
            memcpy(dy, dy_end, sizeof dy);
            for (int c = 0; c < 2; c++) {
                state[c] += moved[c];
                TANGENT_SUM(sum, dxy[c], d_moved[c])
                dxy[c] = sum;
            }
        }
    }
    memcpy(state + 2, y, sizeof y);
    memcpy(rows, dxy, sizeof dxy);
    memcpy(rows + 2, dy, sizeof dy);
    for (int c = 0; c < VARIED; c++) {
        const double w = rows[2][c], i = rows[3][c], j = rows[4][c], k = rows[5][c];
        end[c] = rows[0][c];
        end[VARIED + c] = rows[1][c];
        /* Vector part of 2 conj(q) dq. */
        end[2 * VARIED + c] = 2.0 * (q[0] * i - q[1] * w - q[2] * k + q[3] * j);
        end[3 * VARIED + c] = 2.0 * (q[0] * j + q[1] * k - q[2] * w - q[3] * i);
        end[4 * VARIED + c] = 2.0 * (q[0] * k - q[1] * j + q[2] * i - q[3] * w);
        for (int l = 0; l < 3; l++)
            end[(5 + l) * VARIED + c] = rows[6 + l][c];
    }
}
