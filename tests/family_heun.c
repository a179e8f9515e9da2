/* family_heun.c - a family of your own: Heun's method on the ODE on D (h), each step projected onto
 * D.  It needs nothing but the public headers, and is loaded while a program runs. */
#include <dalembert/family.h>

#include <stdlib.h>
#include <string.h>

static int make(void **method, dal_motion *motion, dal_error *error)
{
    *method = calloc(6 * dal_system_n(motion->system), sizeof(double));
    if (error) error->status = *method ? DAL_SUCCESS : DAL_ENOMEM;
    return *method ? DAL_SUCCESS : DAL_ENOMEM;
}

static int advance(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    const size_t N = 2 * dal_system_n(motion->system);
    const double h = motion->h;
    double *const y = method, *const before = y + N, *const after = before + N;
    for (*done = 0; *done < steps; ++*done) {
        const double t = motion->t0 + (double)(motion->steps + *done) * h;
        int status = dal_field(motion->mechanics, t, motion->x, before);
        for (size_t i = 0; i < N; i++) y[i] = motion->x[i] + h * before[i];
        if (!status) status = dal_field(motion->mechanics, t + h, y, after);
        for (size_t i = 0; i < N; i++) y[i] = motion->x[i] + h / 2 * (before[i] + after[i]);
        if (!status) status = dal_project(motion->mechanics, t + h, 0.0, y, NULL);
        if (status) return status;
        memcpy(motion->x, y, N * sizeof *y);
    }
    return DAL_SUCCESS;
}

static const dal_family heun = {
    .name = "heun", .make = make, .free = free, .advance = advance, .no_reaction = 1};

extern DAL_API const dal_scheme heun_scheme;
const dal_scheme heun_scheme = {
    .name = "heun", .help = "Heun's method, projected onto D", .family = &heun, .order = 2};
