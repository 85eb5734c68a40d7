/* Copyright 2026 sphere_nmpc contributors
 * SPDX-License-Identifier: Apache-2.0
 *
 * Tilt of the axis about which the sphere rolls in the interval of steady rolling: a . k at its
 * start, k the vertical in body axes.
 */
static int has_tilt(const problem *p)
{
    return p->steady_interval > 0 && !p->disturbed;
}

/* The tilt at quaternion `q`. */
static double tilt(const problem *p, const double *q)
{
    const double *a = p->steady_axis;
    return 2.0 * (a[0] * (q[1] * q[3] - q[0] * q[2]) + a[1] * (q[2] * q[3] + q[0] * q[1]));
}

/* Add the derivative of the tilt by the quaternion to one of the ROW residuals. */
static void add_tilt_row(const problem *p, const double *q, int row, double (*sensitivity)[ROW])
{
    const double *a = p->steady_axis;
    sensitivity[0][row] += 2.0 * (a[1] * q[1] - a[0] * q[2]);
    sensitivity[1][row] += 2.0 * (a[0] * q[3] + a[1] * q[0]);
    sensitivity[2][row] += 2.0 * (a[1] * q[3] - a[0] * q[0]);
    sensitivity[3][row] += 2.0 * (a[0] * q[1] + a[1] * q[2]);
}
