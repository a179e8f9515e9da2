/* The family pair: the velocity integrator of two difference maps, one for L_d and one for D_d. */
#include "dalembert/discrete.h"
#include "step/step.h"

#include <math.h>
#include <string.h>

extern const dal_family dal__family_pair;

/* "pair:A:B": rho^A for L_d, rho^B for D_d. */
static bool read_name(const char *name, dal_pair *maps)
{
    const char *end = name;
    if (strncmp(name, "pair:", 5) != 0) return false;
    maps->lagrangian = (dal_difference_map){.beta = dal__parse_number(name + 5, &end)};
    if (*end != ':') return false;
    maps->constraint = (dal_difference_map){.beta = dal__parse_number(end + 1, &end)};
    return *end == '\0' && maps->lagrangian.beta <= 1.0 && maps->constraint.beta <= 1.0;
}

static int parse(dal_scheme *scheme, const char *name)
{
    dal_pair maps;
    if (!read_name(name, &maps)) return 0;
    const bool midpoint = maps.lagrangian.beta == 0.5 && maps.constraint.beta == 0.5;
    *scheme = (dal_scheme){.family = &dal__family_pair, .order = midpoint ? 2 : 1,
                           .symmetric = midpoint, .help = "two maps, for L_d and for D_d",
                           .reference = "Jimenez and Scheurle, arXiv 1407.2116"};
    return 1;
}

static int make(void **method, dal_motion *motion, dal_error *error)
{
    const dal_scheme *const scheme = motion->scheme;
    dal_pair named;
    const dal_pair *const maps = scheme->data ? scheme->data : &named;
    dal_discrete *discrete;
    int status = dal__scheme_check_plain(scheme, "pair", error);
    if (status) return status;
    if (!scheme->data && !read_name(scheme->name, &named))
        return dal__fail(error, DAL_EINVAL, "scheme.data is NULL and scheme.name = \"%s\" is not "
                         "pair:A:B with A and B in [0, 1]", scheme->name);
    status = dal_discrete_new(&discrete, motion->system, &maps->lagrangian,
                              &maps->constraint, error);
    if (!status) *method = discrete;
    return status;
}

static void release(void *method) { dal_discrete_free(method); }

static int advance(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    dal_discrete *const discrete = method;
    const size_t m = dal_system_m(motion->system);
    const double h = motion->h;
    double *const lambda = motion->mechanics->lambda;
    int status = DAL_SUCCESS;
    for (*done = 0; !status && *done < steps; *done += !status) {
        const double t = motion->t0 + (double)(motion->steps + *done) * h;
        status = dal__discrete_advance(discrete, t, h, motion->x, lambda,
                                       &motion->stats->worst_residual);
        for (size_t a = 0; !status && a < m; a++) motion->impulse[a] += h * lambda[a];
    }
    if (status) *motion->error = *dal__discrete_error(discrete);
    return status;
}

/* What tells maps apart, of which one of the user's own may be any. */
static double number(const dal__rho *rho) { return rho->map.map ? -1.0 : rho->map.beta; }

/* Which maps they are: nothing else is kept from step to step. */
static size_t save(const void *method, double *values)
{
    const dal_discrete *const discrete = method;
    if (values) {
        values[0] = number(&discrete->lagrangian);
        values[1] = number(&discrete->constraint);
    }
    return 2;
}

static int accepts(const void *method, const double *values)
{
    double own[2];
    save(method, own);
    return values[0] == own[0] && values[1] == own[1];
}

const dal_family dal__family_pair = {
    .name = "pair",
    .help = "pair:A:B with A and B in [0, 1]",
    .parse = parse,
    .make = make,
    .free = release,
    .advance = advance,
    .save = save,
    .accepts = accepts,
};
