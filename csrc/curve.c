/* Floor 3: curves inside D: the cut-off functions and the curve between two states. */
#include "internal.h"

#include <math.h>
#include <string.h>

void dal_cutoff(double tau, double *chi0, double *chi1, double *slope)
{
    static const double pi = 3.14159265358979323846;
    double first = 1.0, second = 0.0, change = 0.0;
    if (tau > 0.0 && tau < 1.0) {
        /* w = |cot(pi tau)|; s and 1/2 - s are exact where their form is used */
        const double s = tau <= 0.5 ? tau : 1.0 - tau;
        const double w = s < 0.25 ? 1.0 / tan(pi * s) : tan(pi * (0.5 - s));
        const double e = w > 370.0 ? 0.0 : exp(-2.0 * w);
        const double large = 1.0 / (1.0 + e), small = e / (1.0 + e);
        first = tau <= 0.5 ? large : small;
        second = tau <= 0.5 ? small : large;
        change = e > 0.0 ? -2.0 * pi * (1.0 + w * w) * large * small : 0.0;
    } else if (tau >= 1.0) {
        first = 0.0;
        second = 1.0;
    } else if (isnan(tau)) {
        first = second = change = tau;
    }
    if (chi0) *chi0 = first;
    if (chi1) *chi1 = second;
    if (slope) *slope = change;
}

int dal_chart_curve(dal_chart *chart, const double *x1, const double *x2, double tau, double *x)
{
    if (!chart) return DAL_EINVAL;
    dal_mechanics *const mech = &chart->mech;
    const size_t n = chart->n;
    double chi0, chi1;
    if (!x) return dal__null_argument(mech, "x");
    int status = dal__chart_ready(chart);
    if (!status) status = dal__require_finite(mech, "x1", 2 * n, x1);
    if (!status) status = dal__require_finite(mech, "x2", 2 * n, x2);
    if (!status) status = dal__require_finite(mech, "tau", 1, &tau);
    if (status) return status;
    dal_cutoff(tau, &chi0, &chi1, NULL);
    for (size_t i = 0; i < 2 * n; i++) chart->x[i] = chi0 * x1[i] + chi1 * x2[i];
    dal__chart_drop(chart, chart->x, chart->y);
    status = dal__chart_lift(chart, chart->y, chart->x);
    if (!status) memcpy(x, chart->x, 2 * n * sizeof *x);
    return status;
}
