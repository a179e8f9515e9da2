/* A system, a scheme and a state that is stepped. */
#include "step/step.h"
#include "dalembert/kernel.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

struct dal_stepper {
    const dal_system *system;
    dal_kernel kernel;
    dal_kernel_fn advance; /* the compilation of the step routine; NULL: one of the next two */
    newton newton;
    multiroot *multiroot;    /* NULL: newton */
    dal_mechanics mech;      /* for initial data, for these two, and for what went wrong */
    size_t substeps;
    dal_substep *substep;
    dal_stage *stage;
    double *fresh;           /* [2n] initial data being examined */
    double t0;
    size_t steps;            /* since the start: t = t0 + steps h */
    int order;               /* of the scheme */
    dal__jump jump;
    bool started;
    dal_error error;
    arena arena;
};

/* A record as stages: one for each sub-step, but a pair (0, a), (1, b) is one (see kernel.h). */
static size_t plan_stages(const dal_substep *substep, size_t count, dal_stage *stage)
{
    size_t stages = 0;
    for (size_t j = 0; j < count; j++) {
        const double beta = substep[j].beta, f = substep[j].fraction;
        const bool pair = j + 1 < count && beta == 0.0 && substep[j + 1].beta == 1.0;
        const double g = pair ? substep[++j].fraction : 0.0;
        dal_stage s = {.before = (1.0 - beta) * f, .after = beta * f + g, .span = f + g};
        if (beta == 0.0) {
            s.node = f + g;
        } else {
            s.start = beta * f;
            s.end = (1.0 - beta) * f;
        }
        stage[stages++] = s;
    }
    for (size_t j = 0; j < stages; j++)
        stage[j].reuse = fmax(fabs(stage[j].end), fabs(stage[(j + 1) % stages].start));
    return stages;
}

/* Weights of the parabola through the values at times t[0..2] at the time t; where these lie too
 * close together to extrapolate (compositions go back and forth), of the line through the last two,
 * or the last value. */
static void extrapolate(const double times[3], double t, double weight[3])
{
    const double most = 10.0;
    const double a = t - times[0], b = t - times[1], c = t - times[2];
    const double ab = times[0] - times[1], ac = times[0] - times[2], bc = times[1] - times[2];
    const double parabola[3] = {b / ab * (c / ac), -a / ab * (c / bc), a / ac * (b / bc)};
    const double line[3] = {b / ab, -a / ab, 0.0}, last[3] = {1.0, 0.0, 0.0};
    const double *const choice[3] = {parabola, line, last};
    for (int i = 0; i < 3; i++) {
        memcpy(weight, choice[i], 3 * sizeof *weight);
        if (fabs(weight[0]) + fabs(weight[1]) + fabs(weight[2]) <= most) return;
    }
}

/* The pull of a stage, a change of velocity over its span, belongs to the time of its node. */
static void plan_predictions(dal_stage *stage, size_t stages)
{
    for (size_t j = 0; j < stages; j++) {
        double times[3], spans[3], start = 0.0; /* before the start of stage j */
        for (size_t back = 1; back <= 3; back++) {
            const dal_stage *s = stage + (j + 3 * stages - back) % stages;
            start -= s->span;
            times[back - 1] = start + s->before;
            spans[back - 1] = s->span;
        }
        extrapolate(times, stage[j].before, stage[j].ahead);
        for (int i = 0; i < 3; i++) /* a fused pair (0, a), (1, -a) has no span, and no lambda */
            stage[j].ahead[i] *= spans[i] != 0.0 ? stage[j].span / spans[i] : 0.0;
    }
}

static void reserve_kernel(dal_kernel *k, size_t n, size_t m, arena *a)
{
    const size_t mn = dal__times(m, n), mm = dal__times(m, m), nn = dal__times(n, n);
    dal_arrays *const at = &k->at;
    double **const vectors[] = {&k->force0, &k->force1, &at->base, &at->goal, &at->step,
                                &at->seen, &at->stored, &k->y, &k->R};
    double **const multipliers[] = {&k->impulse, &at->r, &at->d, &at->kappa};
    dal__reserve(a, &at->x, dal__times(dal_kernel_shared(1, m), n), sizeof(double));
    dal__reserve(a, &k->saved, dal__times(2, n), sizeof(double));
    dal__reserve_doubles(a, DAL_LENGTH(vectors), vectors, n);
    dal__reserve_doubles(a, DAL_LENGTH(multipliers), multipliers, m);
    dal__reserve(a, &at->Z, mn, sizeof(double));
    dal__reserve(a, &at->S, mm, sizeof(double));
    dal__reserve(a, &at->sizes, dal__times(5, m), sizeof(double));
    dal__reserve(a, &at->row, m, sizeof(size_t));
    dal__reserve(a, &k->K, nn, sizeof(double));
    dal__reserve(a, &k->K_sizes, dal__times(5, n), sizeof(double));
    dal__reserve(a, &k->K_row, n, sizeof(size_t));
}

static int check_options(const dal_options *options, dal_error *error)
{
    if (options->solver != DAL_SOLVER_SCHUR && options->solver != DAL_SOLVER_MULTIROOT)
        return dal__fail(error, DAL_EINVAL, "options.solver = %d is not a dal_solver",
                         (int)options->solver);
    if (options->sizes != DAL_SIZES_AUTO && options->sizes != DAL_SIZES_RUNTIME)
        return dal__fail(error, DAL_EINVAL, "options.sizes = %d is not a dal_sizes",
                         (int)options->sizes);
    if (options->max_iterations < 0)
        return dal__fail(error, DAL_EINVAL, "options.max_iterations = %d is negative",
                         options->max_iterations);
    return DAL_SUCCESS;
}

/* Whether the step routine knows mu(q~') before v'. */
static bool is_steady(const dal_stepper *self, bool kept)
{
    bool ends = false; /* V acts at some q~' */
    for (size_t j = 0; j < self->kernel.stages; j++)
        if (self->stage[j].end != 0.0) ends = true;
    return self->system->def.steady && !kept && !(self->system->def.potential && ends);
}

/* Whether kernel.h makes its steps; those of all others are newton's. */
static bool has_step_routine(const dal_system *system)
{
    return system->mass && !system->def.force && system->def.kind == DAL_LINEAR;
}

static void bind_kernel(dal_stepper *self, const dal_scheme *scheme, const dal_options *options)
{
    const dal_system *system = self->system;
    dal_kernel *const k = &self->kernel;
    k->n = system->def.n;
    k->m = system->def.m;
    k->constraint = self->mech.eval.constraint;
    k->constraint_ctx = self->mech.eval.constraint_ctx;
    k->potential = self->mech.eval.potential;
    k->potential_ctx = self->mech.eval.potential_ctx;
    k->mass = system->mass;
    k->mass_inverse = system->mass_inverse;
    k->unit = system->unit;
    k->per_unit = system->per_unit;
    k->diagonal = system->diagonal;
    k->stage = self->stage;
    k->stages = plan_stages(self->substep, self->substeps, self->stage);
    plan_predictions(self->stage, k->stages);
    k->kept = scheme->nodes == DAL_KEPT_NODES;
    k->shift = k->kept ? 1.0 - self->substep[0].beta : 0.0;
    k->max_iterations = options->max_iterations ? options->max_iterations : 50;
    dal_kernel_share(k, k->at.x);
    k->finish = dal__kernel_finish;
    k->steady = is_steady(self, k->kept);
    k->proved = system->def.steady == DAL_STEADY_PROVED;
    if (has_step_routine(system) && options->solver == DAL_SOLVER_SCHUR)
        self->advance = system->def.kernel && !k->kept && options->sizes == DAL_SIZES_AUTO
                            ? system->def.kernel
                            : dal__kernel_for(k->n, k->m, options->sizes);
    dal__newton_bind(&self->newton, system, k->max_iterations);
}

int dal_stepper_new(dal_stepper **stepper, const dal_system *system, const dal_scheme *scheme,
                    const dal_options *options, dal_error *error)
{
    const dal_options defaults = {0};
    if (!options) options = &defaults;
    dal__fail(error, DAL_SUCCESS, "%s", "");
    if (!stepper || !system || !scheme)
        return dal__fail(error, DAL_EINVAL, "%s is NULL",
                         !stepper ? "stepper" : !system ? "system" : "scheme");
    int status = dal__scheme_check(scheme, error);
    if (!status) status = check_options(options, error);
    if (status) return status;

    const size_t n = system->def.n, m = system->def.m, count = dal__scheme_count(scheme);
    dal_stepper shape = {.system = system, .substeps = count}, *self;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    dal__mechanics_reserve(&shape.mech, system, &memory);
    reserve_kernel(&shape.kernel, n, m, &memory);
    if (!has_step_routine(system)) dal__newton_reserve(&shape.newton, system, &memory);
    dal__reserve(&memory, &shape.substep, count, sizeof *shape.substep);
    dal__reserve(&memory, &shape.stage, count, sizeof *shape.stage);
    dal__reserve(&memory, &shape.fresh, dal__times(2, n), sizeof(double));
    status = dal__allocate(&memory, error);
    if (status) return status;
    /* the slots that the arena has filled are those of shape */
    *self = shape;
    self->arena = memory;
    dal__mechanics_bind(&self->mech, system);
    for (size_t j = 0; j < count; j++) self->substep[j] = dal__scheme_substep(scheme, j);
    self->order = scheme->order;
    bind_kernel(self, scheme, options);
    if (options->solver == DAL_SOLVER_MULTIROOT) {
        status = dal__multiroot_new(&self->multiroot, system, error);
        if (status) {
            dal_stepper_free(self);
            return status;
        }
    }
    *stepper = self;
    return DAL_SUCCESS;
}

void dal_stepper_free(dal_stepper *stepper)
{
    if (!stepper) return;
    dal__multiroot_free(stepper->multiroot);
    arena memory = stepper->arena; /* the object lies inside it */
    dal__release(&memory);
}

const char *dal_stepper_message(const dal_stepper *stepper) { return stepper->error.text; }
const double *dal_stepper_state(const dal_stepper *stepper) { return stepper->kernel.at.x; }

const dal_system *dal__stepper_system(const dal_stepper *stepper) { return stepper->system; }
dal_error *dal__stepper_error(dal_stepper *stepper) { return &stepper->error; }

double dal_stepper_time(const dal_stepper *stepper)
{
    return stepper->t0 + (double)stepper->steps * stepper->kernel.h;
}

void dal_stepper_stats(const dal_stepper *stepper, dal_stats *stats)
{
    const evaluator *const e = &stepper->mech.eval;
    *stats = stepper->kernel.stats;
    stats->substeps = stats->steps * stepper->substeps;
    stats->worst_residual *= 1.0 + 2.0 * DBL_EPSILON; /* the step compares without dividing */
    /* the evaluator counts what goes through it; the step routine's calls do if it differences */
    if (e->constraint_ctx == e) stats->constraint_calls = 0;
    if (e->potential_ctx == e) stats->potential_calls = 0;
    stats->constraint_calls += e->constraint_calls;
    stats->potential_calls += e->potential_calls;
    stats->lagrangian_calls = e->lagrangian_calls;
    stats->force_calls = e->force_calls;
    stats->differenced = stepper->system->def.missing;
    stats->jump_step = stepper->jump.step;
    stats->jump = stepper->jump.change;
    stats->largest_kinetic = stepper->jump.kinetic;
}

/* ---- start ------------------------------------------------------------------------------ */

static int check_start(dal_stepper *self, double t0, double h, const double *x,
                       dal_consistency consistency, dal_initial initial)
{
    const dal_kernel *const k = &self->kernel;
    dal_error *const error = &self->error;
    if (!x) return dal__fail(error, DAL_EINVAL, "x is NULL");
    if (!isfinite(t0)) return dal__fail(error, DAL_EINVAL, "t0 = %g is not finite", t0);
    if (!isfinite(h) || h == 0.0 || !isfinite(1.0 / h))
        return dal__fail(error, DAL_EINVAL, "h = %g: a step that is finite and not 0 is needed", h);
    if (t0 + h == t0)
        return dal__fail(error, DAL_EINVAL, "h = %g does not change t0 = %.17g", h, t0);
    for (size_t i = 0; i < 2 * k->n; i++)
        if (!isfinite(x[i]))
            return dal__fail(error, DAL_EINVAL, "%s[%zu] = %g is not finite", i < k->n ? "q" : "v",
                             i < k->n ? i : i - k->n, x[i]);
    if ((int)consistency < DAL_CHECK || consistency > DAL_ASSUME)
        return dal__fail(error, DAL_EINVAL, "consistency = %d is not a dal_consistency",
                         (int)consistency);
    if ((int)initial < DAL_INITIAL_NONE || initial > DAL_INITIAL_SHIFT)
        return dal__fail(error, DAL_EINVAL, "initial = %d is not a dal_initial", (int)initial);
    if (k->kept && initial == DAL_INITIAL_NONE)
        return dal__fail(error, DAL_EINVAL, "a scheme with kept nodes needs initial: data in D "
                         "used as they are, in D_eps, projected onto D_eps, or shifted to the "
                         "node");
    if (!k->kept && initial != DAL_INITIAL_NONE)
        return dal__fail(error, DAL_EINVAL, "initial = %d: only a scheme with kept nodes takes it",
                         (int)initial);
    return DAL_SUCCESS;
}

/* The steps of a start leave the text of their failure in the error of self->mech. */

/* fresh <- consistent data of D (shift = 0) or D_eps; what was found and done goes to stats. */
static int make_consistent(dal_stepper *self, double shift, dal_consistency consistency,
                           dal_stats *stats)
{
    dal_mechanics *const mech = &self->mech;
    bool consistent;
    int status = dal__lies_in_D(mech, shift, self->fresh, &stats->initial_residual, &consistent);
    if (!status && consistency == DAL_CHECK && !consistent)
        return dal__fail(&mech->error, DAL_EOFFD, "the initial data do not lie in %s: their "
                         "residual is %.3g, more than roundoff and %g of the terms of phi",
                         shift == 0.0 ? "D" : "D_eps", stats->initial_residual, DAL_CONSISTENT);
    if (!status && consistency != DAL_ASSUME)
        status = dal_project(mech, shift, self->fresh, &stats->initial_correction);
    return status;
}

/* Whether a system that is declared steady is so at the initial data, where mu and d(mu v)/dq are
 * in mech: no coordinate that mu depends on is pushed by a reaction. */
static int check_steady(dal_mechanics *mech)
{
    const size_t n = mech->n, m = mech->m;
    dal__form_Z(mech, mech->mu);
    for (size_t i = 0; i < n; i++) {
        double pushed = 0.0, turns = 0.0;
        for (size_t a = 0; a < m; a++) {
            pushed = fmax(pushed, fabs(mech->Z[a * n + i]));
            turns = fmax(turns, fabs(mech->dmu[a * n + i]));
        }
        if (pushed != 0.0 && turns != 0.0)
            return dal__fail(&mech->error, DAL_EINVAL, "the system is declared steady, but "
                             "coordinate %zu is pushed by a reaction (M^-1 mu^T has %g there), and "
                             "mu depends on it (d(mu v)/dq has %g)", i, pushed, turns);
    }
    return DAL_SUCCESS;
}

/* Every output that the steps will ask for, once, into buffers that are NaN: what is never written
 * is found here. */
static int probe(dal_stepper *self, double t0)
{
    dal_mechanics *const mech = &self->mech;
    const double *const q = self->fresh, *const v = self->fresh + mech->n;
    const dal__jet jet = {.L_q = mech->force, .L_v = mech->momentum, .L_qq = mech->hessian,
                          .L_vq = mech->L_vq, .L_vv = mech->L_vv};
    const dal__jet simple = {.L_q = mech->force, .L_qq = mech->hessian};
    int status = dal__constraint(&mech->eval, q, v, mech->phi, mech->mu, mech->dmu, &mech->error);
    if (!status && mech->eval.system->def.steady) status = check_steady(mech);
    if (!status)
        status = dal__lagrangian(&mech->eval, q, v, mech->eval.constant_mass ? &simple : &jet,
                                 &mech->error);
    if (!status && mech->eval.system->def.force)
        status = dal__force(&mech->eval, t0, q, v, mech->force, mech->f_q, mech->f_v,
                            &mech->error);
    return status;
}

/* q <- q + shift v. */
static int move_node(dal_stepper *self, double shift, double *x)
{
    const size_t n = self->kernel.n;
    for (size_t i = 0; i < n; i++) x[i] += shift * x[n + i];
    if (dal__all_finite(n, x)) return DAL_SUCCESS;
    return dal__fail(&self->mech.error, DAL_EDOMAIN, "q + %g v overflows", shift);
}

int dal_stepper_start(dal_stepper *stepper, double t0, double h, const double *x,
                      dal_consistency consistency, dal_initial initial)
{
    if (!stepper) return DAL_EINVAL;
    dal_stepper *const self = stepper;
    dal_kernel *const k = &self->kernel;
    const size_t n = k->n;
    const double shift = k->shift * h;
    dal_stats stats = {0};
    int status = check_start(self, t0, h, x, consistency, initial);
    if (status) return status;

    evaluator *const e = &self->mech.eval;
    e->constraint_calls = e->potential_calls = e->lagrangian_calls = e->force_calls = 0;
    memcpy(self->fresh, x, 2 * n * sizeof *x);
    status = probe(self, t0);
    if (!status)
        status = make_consistent(self, initial == DAL_INITIAL_D_EPS ? shift : 0.0, consistency,
                                 &stats);
    if (!status && initial == DAL_INITIAL_PROJECT)
        status = dal_project(&self->mech, shift, self->fresh, &stats.initial_correction);
    if (!status && initial == DAL_INITIAL_SHIFT) status = move_node(self, shift, self->fresh);
    dal__jump jump = {0};
    if (!status) status = dal__jump_start(&jump, &self->mech, self->order, shift, self->fresh);
    if (status) {
        self->error = self->mech.error;
        return status;
    }

    memcpy(k->at.x, self->fresh, 2 * n * sizeof *x);
    k->h = h;
    k->stats = stats;
    dal_kernel_forget(k);
    dal__newton_forget(&self->newton);
    self->t0 = t0;
    self->steps = 0;
    self->jump = jump;
    self->started = true;
    self->error.text[0] = '\0';
    return DAL_SUCCESS;
}

/* ---- steps ------------------------------------------------------------------------------ */

/* The number that was not finite in the step that failed, looked for by evaluating again, with
 * checks, where the step evaluated: from q~ to the node to the last iterate. */
static void find_not_finite(dal_stepper *self, dal_error *found)
{
    const dal_kernel *const k = &self->kernel;
    dal_mechanics *const mech = &self->mech;
    const size_t n = k->n;
    double *const start = self->fresh;
    for (size_t i = 0; i < n; i++) start[i] = k->at.x[i] - k->shift * k->h * k->at.x[n + i];
    if (dal__all_finite(n, k->at.node)
        && (dal__potential(&mech->eval, start, NULL, mech->force, NULL, found)
            || dal__constraint(&mech->eval, k->at.node, k->at.x + n, NULL, mech->mu, NULL, found)
            || dal__potential(&mech->eval, k->at.node, NULL, mech->force, NULL, found)))
        return;
    if (dal__all_finite(n, k->at.point) && dal__all_finite(n, k->at.w)
        && (dal__constraint(&mech->eval, k->at.point, k->at.w, NULL, mech->mu, mech->dmu, found)
            || dal__potential(&mech->eval, k->at.point, NULL, mech->force, NULL, found)))
        return;
    dal__fail(found, DAL_EDOMAIN, "a number is not finite; try a smaller h");
}

/* What went wrong in the step that failed, in words. */
static void explain(dal_stepper *self, int status)
{
    dal_kernel *const k = &self->kernel;
    dal_error *const found = &self->mech.error;
    const double t = dal_stepper_time(self);
    char what[320];
    switch (k->failure.kind) {
    case DAL_FAILED_CONSTRAINT:
    case DAL_FAILED_POTENTIAL:
        snprintf(what, sizeof what, "%s returned %d (%s)",
                 k->failure.kind == DAL_FAILED_CONSTRAINT ? "constraint" : "potential",
                 k->failure.returned,
                 k->failure.returned > 0 ? "outside its domain; try a smaller h" : "stop");
        break;
    case DAL_FAILED_FINITE:
        find_not_finite(self, found);
        snprintf(what, sizeof what, "%.300s", found->text);
        break;
    case DAL_FAILED_SINGULAR_S:
        snprintf(what, sizeof what, "the Schur complement (mu(q') + beta h d(mu v)/dq) M^-1 "
                 "mu(q_k)^T is singular: the constraints lose rank, or h is too large here");
        break;
    case DAL_FAILED_SINGULAR_K:
        snprintf(what, sizeof what, "M + h^2 beta (1-beta) V_qq is singular: h is too large here");
        break;
    case DAL_FAILED_SINGULAR_C:
        snprintf(what, sizeof what, "no velocity of D was found at the new position: mu M^-1 mu^T "
                 "is singular there, or, with kept nodes, h is too large");
        break;
    case DAL_FAILED_STEADY:
        snprintf(what, sizeof what, "the system is declared steady, but mu at the end of the step "
                 "is not what it was before the reaction acted: a coordinate that mu depends on is "
                 "pushed by a reaction");
        break;
    case DAL_FAILED_ROOT:
        snprintf(what, sizeof what, DAL__LOST_TEXT, k->failure.travelled, k->failure.first,
                 k->failure.scale);
        break;
    case DAL_FAILED_BRANCH:
        snprintf(what, sizeof what, DAL__BRANCH_TEXT);
        break;
    case DAL_FAILED_CONVERGE:
        snprintf(what, sizeof what, "Newton did not converge in %d iterations: last change %.3g of "
                 "%.3g; try a smaller h", k->failure.iterations, k->failure.size, k->failure.scale);
        break;
    }
    dal__fail(&self->error, status, "step %zu (t = %g, h = %g): %s", self->steps + 1, t, k->h,
              what);
}

/* The same records by a solver for all unknowns, sub-step by sub-step; what went wrong is in the
 * error of self->mech. */
static int advance_by_substeps(dal_stepper *self, size_t steps, size_t *done)
{
    dal_kernel *const k = &self->kernel;
    double *const x = k->saved;
    for (*done = 0; *done < steps; ++*done) {
        double passed = 0.0; /* fraction of the step */
        memcpy(x, k->at.x, 2 * k->n * sizeof *x);
        for (size_t j = 0; j < self->substeps; j++) {
            const dal_substep s = self->substep[j];
            const double t = self->t0 + ((double)(self->steps + *done) + passed) * k->h;
            const double h = s.fraction * k->h;
            const int status =
                self->multiroot
                    ? dal__multiroot_step(self->multiroot, &self->mech, t, s.beta, h, k->kept, x,
                                          k->at.kappa, &k->stats)
                    : dal__newton_step(&self->newton, &self->mech, t, s.beta, h, k->kept, x,
                                       k->at.kappa, &k->stats);
            if (status) return status;
            for (size_t a = 0; a < k->m; a++) k->impulse[a] += k->at.kappa[a];
            passed += s.fraction;
        }
        memcpy(k->at.x, x, 2 * k->n * sizeof *x);
        k->stats.steps++;
    }
    return DAL_SUCCESS;
}

int dal__stepper_look(dal_stepper *stepper)
{
    const int status = dal__jump_look(&stepper->jump, &stepper->mech, stepper->steps,
                                      stepper->kernel.at.x);
    if (status) stepper->error = stepper->mech.error;
    return status;
}

/* The text of the step that failed. */
static void complain(dal_stepper *self, int status)
{
    if (self->advance)
        explain(self, status);
    else
        dal__fail(&self->error, status, "step %zu (t = %g, h = %g): %.400s", self->steps + 1,
                  dal_stepper_time(self), self->kernel.h, self->mech.error.text);
}

/* steps steps, with a look at the energy after every 64th since the start. */
static int advance(dal_stepper *self, size_t steps, size_t *made)
{
    enum { BETWEEN_LOOKS = 64 };
    dal_kernel *const k = &self->kernel;
    for (*made = 0; *made < steps;) {
        const size_t left = steps - *made, next = BETWEEN_LOOKS - self->steps % BETWEEN_LOOKS;
        const size_t count = next < left ? next : left;
        size_t done = 0;
        const int status = self->advance ? self->advance(k, count, &done)
                                         : advance_by_substeps(self, count, &done);
        self->steps += done;
        *made += done;
        if (status) {
            complain(self, status);
            return status;
        }
        const int stopped = self->steps % BETWEEN_LOOKS == 0 ? dal__stepper_look(self) : 0;
        if (stopped) return stopped;
    }
    return DAL_SUCCESS;
}

int dal_advance(dal_stepper *stepper, size_t steps, double *reaction, size_t *done)
{
    if (done) *done = 0;
    if (!stepper) return DAL_EINVAL;
    dal_stepper *const self = stepper;
    dal_kernel *const k = &self->kernel;
    if (!self->started)
        return dal__fail(&self->error, DAL_EINVAL, "the stepper was not started");
    size_t made = 0;
    for (size_t a = 0; a < k->m; a++) k->impulse[a] = 0.0;
    const int status = advance(self, steps, &made);
    if (done) *done = made;
    if (status || !reaction || steps == 0) return status;
    for (size_t a = 0; a < k->m; a++) k->impulse[a] /= (double)steps * k->h;
    for (size_t a = 0; a < k->m; a++)
        if (!isfinite(k->impulse[a]))
            return dal__fail(&self->error, DAL_EDOMAIN, "reaction[%zu] = %g is not finite after "
                             "step %zu (t = %g, h = %g)", a, k->impulse[a], self->steps,
                             dal_stepper_time(self), k->h);
    memcpy(reaction, k->impulse, k->m * sizeof *reaction);
    return DAL_SUCCESS;
}

int dal_step(dal_stepper *stepper, double *reaction)
{
    return dal_advance(stepper, 1, reaction, NULL);
}
