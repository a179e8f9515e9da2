/* The family pair: the velocity integrator of two difference maps, one for L_d and one for D_d. */
#include "discrete/discrete.h"
#include "step/newton.h"
#include "step/scheme.h"

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

/* Maps rho^A and rho^B lead to the equations of a beta-step where L acts elsewhere; what is said of
 * nodes in general takes ten times as long. */
typedef struct pair_steps {
    double alpha, beta;
    newton newton;
    dal_discrete *discrete; /* of maps of the user's own, else NULL */
    double *x, *kappa;      /* [2n], [m] */
    arena arena;
} pair_steps;

static void release(void *method)
{
    pair_steps *const self = method;
    dal_discrete_free(self->discrete);
    dal__release(&self->arena);
}

static int make(void **method, dal_motion *motion, dal_error *error)
{
    const dal_scheme *const scheme = motion->scheme;
    const size_t n = dal_system_n(motion->system), m = dal_system_m(motion->system);
    dal_pair named = {0};
    const dal_pair *const maps = scheme->data ? scheme->data : &named;
    int status = dal__scheme_check_plain(scheme, "pair", error);
    if (status) return status;
    if (!scheme->data && !read_name(scheme->name, &named))
        return dal__fail(error, DAL_EINVAL, "scheme.name = \"%s\": expected pair:A:B with A and B "
                         "in [0, 1], or the two maps in scheme.data", scheme->name);
    const bool own = maps->lagrangian.map || maps->constraint.map;
    pair_steps shape = {.alpha = maps->lagrangian.beta, .beta = maps->constraint.beta}, *self;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    dal__reserve(&memory, &shape.x, dal__times(2, n), sizeof(double));
    dal__reserve(&memory, &shape.kappa, m, sizeof(double));
    if (!own) dal__newton_reserve(&shape.newton, motion->system, &memory);
    status = dal__allocate(&memory, error);
    if (status) return status;
    *self = shape;
    self->arena = memory;
    dal__newton_bind(&self->newton, motion->system, motion->max_iterations);
    /* which checks the maps, of either kind */
    status = dal_discrete_new(&self->discrete, motion->system, &maps->lagrangian,
                              &maps->constraint, error);
    if (status) {
        dal__release(&memory);
        return status;
    }
    if (!own) {
        dal_discrete_free(self->discrete);
        self->discrete = NULL;
    }
    *method = self;
    return DAL_SUCCESS;
}

static void start(void *method, dal_motion *motion)
{
    (void)motion;
    dal__newton_forget(&((pair_steps *)method)->newton);
}

/* The same by the full Newton iteration; C may nearly lose its rank where it had to start anew. */
static int full_step(pair_steps *self, dal_motion *motion, double t, double end)
{
    dal_mechanics *const mech = motion->mechanics;
    dal__rank *const rank = &motion->guards->rank;
    const size_t anew = motion->stats->full_newtons;
    int status = dal__newton_step(&self->newton, mech, t, end, self->alpha, self->beta, motion->h,
                                  false, self->x, self->kappa, motion->stats);
    if (status) return status;
    const bool strays = dal__rank_strays(rank, self->newton.inverse);
    if (!strays && motion->stats->full_newtons == anew) return DAL_SUCCESS;
    return dal__rank_pass(rank, mech, t, 0.0, motion->h, motion->scheme->order, motion->x);
}

/* One step from self->x, in place. */
static int step(pair_steps *self, dal_motion *motion, double number)
{
    const double h = motion->h, t = motion->t0 + number * h, end = motion->t0 + (number + 1.0) * h;
    const size_t m = dal_system_m(motion->system);
    if (!self->discrete) return full_step(self, motion, t, end);
    const int status = dal__discrete_advance(self->discrete, t, h, self->x, self->kappa,
                                             &motion->stats->worst_residual);
    if (status) *motion->error = *dal_discrete_error(self->discrete);
    for (size_t a = 0; a < m; a++) self->kappa[a] *= h;
    return status;
}

static int advance(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    pair_steps *const self = method;
    const size_t n = dal_system_n(motion->system), m = dal_system_m(motion->system);
    if (self->discrete) dal_discrete_input(self->discrete, motion->input);
    for (*done = 0; *done < steps; ++*done) {
        memcpy(self->x, motion->x, 2 * n * sizeof *self->x);
        const int status = step(self, motion, (double)(motion->steps + *done));
        if (status) return status;
        memcpy(motion->x, self->x, 2 * n * sizeof *self->x);
        for (size_t a = 0; a < m; a++) motion->impulse[a] += self->kappa[a];
    }
    return DAL_SUCCESS;
}

/* Which maps these are, of which one of the user's own may be any; and the last step. */
static size_t save(const void *method, double *values)
{
    const pair_steps *const self = method;
    if (values) {
        values[0] = self->discrete ? -1.0 : self->alpha;
        values[1] = self->discrete ? -1.0 : self->beta;
    }
    return 2 + dal__newton_save(&self->newton, values ? values + 2 : NULL);
}

static int accepts(const void *method, const double *values)
{
    const pair_steps *const self = method;
    return values[0] == (self->discrete ? -1.0 : self->alpha)
        && values[1] == (self->discrete ? -1.0 : self->beta)
        && (values[2] == 0.0 || values[2] == 1.0);
}

static void restore(void *method, const double *values)
{
    dal__newton_restore(&((pair_steps *)method)->newton, values + 2);
}

const dal_family dal__family_pair = {
    .name = "pair",
    .help = "pair:A:B with A and B in [0, 1]",
    .parse = parse,
    .make = make,
    .free = release,
    .start = start,
    .advance = advance,
    .save = save,
    .accepts = accepts,
    .restore = restore,
};
