/* The family beta: beta-schemes one after the other (DAELd1, DAELd2, Facil), by the step routine of
 * kernel.h, which leaves to the full Newton iteration what it does not solve. */
#include "step/beta.h"
#include "step/embedded.h"
#include "step/newton.h"
#include "step/scheme.h"
#include "step/stepper.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

typedef struct beta {
    dal_kernel kernel;
    dal_kernel_fn advance; /* the compilation of the step routine */
    newton newton;
    size_t substeps;
    dal_substep *substep;
    dal_stage *stage;
    size_t *ends;    /* sub-steps up to the end of each stage */
    double *weight;  /* [stages+1] of the embedded estimate, once it was asked for */
    dal_motion *motion;
    double *scratch; /* [2n] of finish */
    double *input;   /* [inputs] that V_q at the start of the next step is of */
    double *mass, *mass_inverse; /* [n*n] of masses, unless it is slim; else NULL */
    double *turned;  /* [entries] mu + b N, if there are rows, and */
    dal__linear S;   /* its product with Z^T */
    arena arena;
} beta;

/* Whether mu is stored by rows. */
static bool has_rows(const dal_system *system) { return system->sparse && system->rows; }

/* Whether the system has a step routine of its own, with the callbacks inside, for the steps. */
static bool is_inside(const dal_system *system, const dal_scheme *scheme)
{
    return system->def.compiled && scheme->nodes == DAL_MOVED_NODES;
}

/* The compilation of the step routine that makes the steps. */
static dal_kernel_fn find_routine(const dal_system *system, const dal_scheme *scheme)
{
    const size_t n = system->def.n, m = system->def.m;
    if (is_inside(system, scheme)) return system->def.compiled->advance;
    const bool momenta = dal__has_momenta(system);
    return !momenta && has_rows(system) ? dal__kernel_any(false) : dal__kernel_for(n, m, momenta);
}

/* Whether the step routine needs no matrix of n rows. */
static bool is_slim(const dal_system *system, dal_kernel_fn routine)
{
    return system->sparse && routine == dal__kernel_any(false);
}

bool dal__has_pairs(const dal_system *system)
{
    return !dal__has_momenta(system) && !dal__is_dragged(system);
}

/* A record as stages: one for each sub-step, but where no force depends on v, nor are there
 * momenta, a pair (0, a), (1, b), a + b not 0, is one (see kernel.h).  Of constant mass, stages
 * without a force at q~' need no momenta either. */
static size_t plan_stages(const dal_system *system, const dal_substep *substep, size_t count,
                          dal_stage *stage, size_t *ends)
{
    const bool momenta = dal__has_momenta(system), apart = !dal__has_pairs(system);
    const bool all = !system->mass || system->def.kind != DAL_LINEAR;
    size_t stages = 0;
    double passed = 0.0; /* of the step */
    for (size_t j = 0; j < count; j++) {
        const double beta = substep[j].beta, f = substep[j].fraction;
        const bool pair = !apart && j + 1 < count && beta == 0.0 && substep[j + 1].beta == 1.0
                          && f + substep[j + 1].fraction != 0.0;
        const double g = pair ? substep[++j].fraction : 0.0;
        dal_stage s = {.A = (1.0 - beta) * f, .B = beta * f + g, .span = f + g};
        if (beta == 0.0 && !apart) {
            s.w1 = f + g;
        } else {
            s.w0 = beta * f;
            s.w2 = (1.0 - beta) * f;
        }
        s.t_start = passed;
        s.t_end = passed = j + 1 < count ? passed + s.span : 1.0;
        s.linear = s.B == 0.0;
        s.t_node = s.linear ? s.t_end : s.t_start + s.A;
        s.momentum = momenta && (all || s.w2 != 0.0);
        ends[stages] = j + 1;
        stage[stages++] = s;
    }
    for (size_t j = 0; j < stages; j++)
        stage[j].reuse = fmax(fabs(stage[j].w2), fabs(stage[(j + 1) % stages].w0));
    return stages;
}

/* Which stages with momenta have the same beta; how many kinds there are.  Each is a sub-step. */
static size_t plan_kinds(const dal_substep *substep, dal_stage *stage, size_t stages)
{
    size_t kinds = 0;
    for (size_t j = 0; j < stages; j++) {
        if (!stage[j].momentum) continue;
        stage[j].kind = kinds;
        for (size_t i = 0; i < j; i++)
            if (stage[i].momentum && substep[i].beta == substep[j].beta)
                stage[j].kind = stage[i].kind;
        if (stage[j].kind == kinds) kinds++;
    }
    return kinds;
}

/* weight[count] <- those of the polynomial through the values at times[count] at the time t; where
 * these lie too close together to extrapolate (compositions go back and forth), of that through
 * the first of them, the latest. */
static void extrapolate(size_t count, const double *times, double t, double most, double *weight)
{
    for (size_t used = count; used > 0; used--) {
        double sum = 0.0;
        for (size_t i = 0; i < count; i++) {
            weight[i] = i < used ? 1.0 : 0.0;
            for (size_t j = 0; j < used; j++)
                if (j != i && i < used) weight[i] *= (t - times[j]) / (times[i] - times[j]);
            sum += fabs(weight[i]);
        }
        if (sum <= most) return;
    }
}

/* The pull of a stage, a change of velocity over its span, belongs to the time of its node.  It is
 * predicted from those of the stages of its kind before. */
static void plan_predictions(dal_stage *stage, size_t stages)
{
    enum { PULLS = 3, CHANGES = 4 };
    for (size_t j = 0; j < stages; j++) {
        dal_stage *const s = stage + j;
        double times[CHANGES], spans[CHANGES], start = 0.0; /* before the start of stage j */
        for (size_t back = 1, found = 0; found < CHANGES; back++) {
            const dal_stage *const other = stage + (j + CHANGES * stages * back - back) % stages;
            start -= other->span;
            if (other->momentum != s->momentum || other->kind != s->kind) continue;
            times[found] = start + other->A;
            spans[found++] = other->span;
        }
        extrapolate(PULLS, times, s->A, 10.0, s->predict_3);
        for (int i = 0; i < PULLS; i++) s->predict_3[i] *= s->span / spans[i];
        for (size_t count = 1; count <= CHANGES; count++) {
            extrapolate(count, times, s->A, 20.0, s->predict_4[count]);
            for (size_t i = 0; i < count; i++) s->predict_4[count][i] *= s->span / spans[i];
        }
    }
}

/* The full Newton iteration begins where the stage before it, of the same beta, would lead. */
static void guess(beta *self, const dal_stage *s)
{
    const dal_kernel *const k = &self->kernel;
    newton *const solver = &self->newton;
    solver->warm = s->momentum && k->known[s->kind] > 0;
    if (!solver->warm) return;
    const double *const past = k->history + 4 * s->kind * k->n, weight = s->predict_4[1][0];
    for (size_t i = 0; i < k->n; i++) solver->rate[i] = weight * past[i] / (s->span * k->h);
    for (size_t a = 0; a < k->m; a++) solver->lambda[a] = k->latest[a] / (k->latest_span * k->h);
}

/* Where C is looked at; steps of controlled size look where they are short. */
static void take_range(dal_kernel *k, const dal_motion *motion)
{
    const double *const range = motion->guards->rank.range;
    for (int i = 0; i < 2; i++) k->range[i] = k->at.rows ? range[i] : exp2(range[i]);
    if (!motion->estimate) return;
    k->range[0] = -(double)INFINITY;
    k->range[1] = (double)INFINITY;
}

/* Whether C nearly loses its rank in the step that a stage belongs to. */
static int look_at_rank(const dal_kernel *k, double number, const dal_stage *s)
{
    dal_motion *const motion = ((const beta *)k)->motion;
    return dal__rank_pass(&motion->guards->rank, motion->mechanics,
                          dal_kernel_time(k, number, s->t_start), k->shift * k->h, k->h,
                          motion->scheme->order, k->at.x);
}

/* As look of a dal_kernel. */
static int look(dal_kernel *k, double number, const dal_stage *s, double inverse)
{
    dal_motion *const motion = ((beta *)k)->motion;
    const bool strays =
        dal__rank_strays(&motion->guards->rank, k->at.rows ? inverse : log2(inverse));
    take_range(k, motion);
    const int status = strays ? look_at_rank(k, number, s) : DAL_SUCCESS;
    return status ? dal_kernel_fail(k, status, DAL_FAILED_FINISH) : DAL_SUCCESS;
}

/* As finish of a dal_kernel: the stage by the full Newton iteration from the state before it; or
 * the velocity alone, into D at what is stored.  A pair is one step with V at the node. */
static int finish(dal_kernel *k, double number, const dal_stage *s, bool solved)
{
    beta *const self = (beta *)k; /* of which it is the first member */
    dal_mechanics *const mech = self->motion->mechanics;
    const size_t n = k->n, size = n * sizeof(double);
    const double t_end = dal_kernel_time(k, number, s->t_end);
    const dal_arrays *const at = &k->at;
    double *const x = self->scratch, relative = 0.0;
    int status = DAL_SUCCESS;
    if (solved) {
        memcpy(x, at->stored, size);
        memcpy(x + n, at->w, size);
        k->stats.corrections++;
        status = dal__mend(mech, t_end, k->shift * k->h, false, x, &relative);
        k->stats.worst_residual = fmax(k->stats.worst_residual, relative);
    } else {
        const double beta = s->B / s->span, alpha = s->w1 != 0.0 ? 1.0 : beta;
        memcpy(x, at->x, 2 * size);
        k->stats.full_newtons++;
        if (!self->motion->estimate) status = look_at_rank(k, number, s);
        if (status) return dal_kernel_fail(k, status, DAL_FAILED_FINISH);
        guess(self, s);
        status = dal__newton_step(&self->newton, mech,
                                  dal_kernel_time(k, number, s->t_start), t_end, alpha, beta,
                                  s->span * k->h, k->kept, x, at->kappa, &k->stats);
    }
    if (!status && !dal__all_finite(n, at->v_known)) /* but what the same callbacks give now is */
        status = dal__fail(&mech->error, DAL_EDOMAIN, "the new state is not finite; try a smaller "
                           "h");
    if (status) return dal_kernel_fail(k, status, DAL_FAILED_FINISH);
    memcpy(at->stored, x, size);
    memcpy(at->w, x + n, size);
    return DAL_SUCCESS;
}

/* As measure of a dal_kernel. */
static int measure(dal_kernel *k, double t)
{
    dal_mechanics *const mech = ((beta *)k)->motion->mechanics;
    dal__copy(k->n, k->at.point, mech->forms.q);
    const int status = dal__measure_moves(mech, t, 0.0, k->at.w);
    dal__copy(k->m, mech->forms.moves, k->at.d);
    return status;
}

/* Where there are rows: as factor and solve of a dal_kernel. */
static int factor_rows(dal_kernel *k, double b)
{
    beta *const self = (beta *)k;
    const dal_arrays *const at = &k->at;
    const dal_rows *const rows = at->rows;
    dal__linear *const S = &self->S;
    for (size_t a = 0; a < k->m; a++) { /* the sizes of factor_S in stage.h */
        double size = -0.0;
        for (size_t e = rows->first[a]; e < rows->first[a + 1]; e++) {
            self->turned[e] = at->mu[e] + b * at->N[e];
            size += (fabs(at->mu[e]) + fabs(self->turned[e])) * at->unit[rows->column[e]];
        }
        S->sizes[a] = size;
        S->sizes[k->m + a] = dal_rows_extent(rows, at->mu_node, a, at->unit);
    }
    dal__linear_multiply(S, rows, k->n, self->turned, at->Z);
    const int sign = dal__linear_factor(S);
    at->S[0] = dal__linear_log_inverse(S);
    return sign;
}

static void solve_rows(const dal_kernel *k)
{
    dal__linear_solve(&((const beta *)k)->S, k->at.r, k->at.d);
}

/* The arrays of stages with momenta. */
static void reserve_momenta(dal_kernel *k, size_t n, size_t m, size_t kinds, arena *a)
{
    const size_t nn = dal__times(n, n);
    dal_balance *const of = &k->balance;
    DAL__RESERVE(a, n, &k->momentum, &of->reaction, &of->residual, &of->theta, &of->L_v, &of->F,
                 &of->unit, &of->per_unit);
    DAL__RESERVE(a, nn, &of->L_vq, &of->L_vv, &of->F_q, &of->F_v, &of->K, &of->factors);
    DAL__RESERVE(a, dal__times(m, n), &k->forms);
    DAL__RESERVE(a, m, &of->phi, &k->latest);
    DAL__RESERVE(a, dal__times(dal__times(4, n), kinds), &k->history);
    dal__reserve(a, &k->known, kinds, 1);
}

/* Of mu, as callbacks of the step routine give it. */
static size_t entries_of(const dal_system *system)
{
    return has_rows(system) ? dal_rows_entries(system->rows)
                            : dal__times(system->def.m, system->def.n);
}

static void reserve_kernel(dal_kernel *k, const dal_system *system, arena *a)
{
    const size_t n = system->def.n, m = system->def.m, entries = entries_of(system);
    dal_arrays *const at = &k->at;
    double **const vectors[] = {&k->force0, &k->force1, &at->v_known, &at->v_free, &at->step,
                                &at->seen, &at->stored, &at->from, &at->dq_known, &at->dv_known};
    double **const multipliers[] = {&k->impulse, &at->r, &at->d, &at->kappa};
    dal__reserve(a, &at->x, dal__times(10, n) + dal__times(3, entries), sizeof(double));
    dal__reserve(a, &at->dx, dal__times(2, n), sizeof(double));
    dal__reserve(a, &k->saved, dal__times(3, n), sizeof(double)); /* m <= n */
    dal__reserve_doubles(a, DAL_LENGTH(vectors), vectors, n);
    dal__reserve_doubles(a, DAL_LENGTH(multipliers), multipliers, m);
    dal__reserve(a, &at->Z, entries, sizeof(double));
    dal__reserve(a, &at->S, has_rows(system) ? 1 : dal__times(m, m), sizeof(double));
    dal__reserve(a, &at->sizes, dal__times(5, m), sizeof(double));
    dal__reserve(a, &at->row, m, sizeof(size_t));
}

/* Whether V, if there is one, acts at some q~ or q~'. */
static bool acts_beside_nodes(const beta *self)
{
    for (size_t j = 0; j < self->kernel.stages; j++)
        if (self->stage[j].w0 != 0.0 || self->stage[j].w2 != 0.0) return true;
    return false;
}

/* Whether the step routine knows mu(q~') before v'. */
static bool is_steady(const beta *self, const dal_system *system)
{
    const dal_kernel *const k = &self->kernel;
    bool ends = false; /* V acts at some q~' */
    const bool pulled = k->potential || k->at.dragged;
    for (size_t j = 0; j < k->stages; j++)
        if (self->stage[j].w2 != 0.0) ends = true;
    return system->def.steady && !k->kept && !dal__has_momenta(system) && !(pulled && ends);
}

/* A compiled step routine has to be one of this library. */
static int check_compiled(const dal_system *system, dal_error *error)
{
    const dal_compiled *const compiled = system->def.compiled;
    if (!compiled) return DAL_SUCCESS;
    if (compiled->abi != DAL_COMPILED_ABI || compiled->size != sizeof(dal_kernel))
        return dal__fail(error, DAL_EINVAL, "compiled: number %u and a dal_kernel of %zu bytes, "
                         "expected %u and %zu; compile it with the kernel.h of this library",
                         compiled->abi, compiled->size, DAL_COMPILED_ABI, sizeof(dal_kernel));
    return dal__check_compiled(system, error);
}

/* What the step routine does not find where the system has it. */
static void take_mass(beta *self)
{
    const dal_system *const system = self->motion->system;
    dal_kernel *const k = &self->kernel;
    for (size_t i = 0; self->mass && i < k->n; i++) {
        self->mass[i * (k->n + 1)] = system->mass[i];
        self->mass_inverse[i * (k->n + 1)] = system->mass_inverse[i];
    }
    k->diagonal = system->diagonal;
}

static void bind_kernel(beta *self, dal_motion *motion)
{
    const dal_system *const system = motion->system;
    const dal_scheme *const scheme = motion->scheme;
    dal_kernel *const k = &self->kernel;
    evaluator *const e = &motion->mechanics->eval;
    self->motion = motion;
    self->advance = find_routine(system, scheme);
    const bool slim = is_slim(system, self->advance);
    k->n = system->def.n;
    k->m = system->def.m;
    k->constraint = e->constraint;
    k->constraint_ctx = is_inside(system, scheme) ? system->def.ctx : e->constraint_ctx;
    k->potential = e->potential_force;
    k->potential_ctx = e->potential_force_ctx;
    k->balance_of = dal__balance;
    k->balance_ctx = e;
    k->input = e->own_input;
    k->kind = system->def.kind;
    k->mass = self->mass ? self->mass : system->mass;
    k->mass_inverse = self->mass ? self->mass_inverse : system->mass_inverse;
    k->at.rows = has_rows(system) ? system->rows : NULL;
    k->at.next = slim ? 1 : k->n + 1;
    k->at.dragged = system->sparse && dal__is_dragged(system);
    k->measure = measure;
    k->factor = factor_rows;
    k->solve = solve_rows;
    k->unit = system->unit;
    k->per_unit = system->per_unit;
    k->at.mass_inverse = k->mass_inverse;
    k->at.unit = k->unit;
    k->at.per_unit = k->per_unit;
    take_mass(self);
    k->stage = self->stage;
    k->stages = plan_stages(system, self->substep, self->substeps, self->stage, self->ends);
    k->kinds = plan_kinds(self->substep, self->stage, k->stages);
    plan_predictions(self->stage, k->stages);
    k->kept = scheme->nodes == DAL_KEPT_NODES;
    const bool pulled = k->potential || k->at.dragged;
    k->plain = !k->kept && !(pulled && acts_beside_nodes(self));
    k->shift = k->kept ? 1.0 - self->substep[0].beta : 0.0;
    dal_kernel_layout(k, entries_of(system), k->at.x);
    k->impulse = motion->impulse;
    k->finish = finish;
    k->look = look;
    k->steady = is_steady(self, system) ? system->def.steady : 0;
    k->constant_rate = system->def.steady == DAL_STEADY_DECLARED
            || system->def.steady == DAL_STEADY_CONSTANT_RATE;
    k->balance.known = k->at.v_known;
    motion->x = k->at.x;
    motion->stats = &k->stats;
}

static int make(void **method, dal_motion *motion, dal_error *error)
{
    const dal_system *const system = motion->system;
    const dal_scheme *const scheme = motion->scheme;
    int status = dal__beta_check(scheme, error);
    if (!status) status = check_compiled(system, error);
    if (status) return status;
    const size_t n = system->def.n, count = dal__scheme_count(scheme);
    beta shape = {.substeps = count}, *self;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    reserve_kernel(&shape.kernel, system, &memory);
    if (system->masses && !is_slim(system, find_routine(system, scheme)))
        DAL__RESERVE(&memory, dal__times(n, n), &shape.mass, &shape.mass_inverse);
    if (has_rows(system)) DAL__RESERVE(&memory, entries_of(system), &shape.turned);
    if (has_rows(system))
        dal__linear_reserve_pattern(&shape.S, system->def.m, system->pattern, &memory);
    if (dal__has_momenta(system)) reserve_momenta(&shape.kernel, n, system->def.m, count, &memory);
    dal__newton_reserve(&shape.newton, system, &memory);
    dal__reserve(&memory, &shape.substep, count, sizeof *shape.substep);
    dal__reserve(&memory, &shape.stage, count, sizeof *shape.stage);
    dal__reserve(&memory, &shape.ends, count, sizeof *shape.ends);
    dal__reserve(&memory, &shape.weight, count + 1, sizeof *shape.weight);
    dal__reserve(&memory, &shape.scratch, dal__times(2, n), sizeof(double));
    dal__reserve(&memory, &shape.input, system->def.inputs, sizeof(double));
    status = dal__allocate(&memory, error);
    if (status) return status;
    /* the slots that the arena has filled are those of shape */
    *self = shape;
    self->arena = memory;
    for (size_t j = 0; j < count; j++) self->substep[j] = dal__scheme_substep(scheme, j);
    dal__newton_bind(&self->newton, system, motion->max_iterations);
    bind_kernel(self, motion);
    *method = self;
    return DAL_SUCCESS;
}

static void release(void *method)
{
    dal__release(&((beta *)method)->arena);
}

static void start(void *method, dal_motion *motion)
{
    beta *const self = method;
    self->kernel.t0 = motion->t0;
    self->kernel.h = motion->h;
    take_mass(self);
    take_range(&self->kernel, motion);
    dal_kernel_forget(&self->kernel);
}

/* ---- steps ------------------------------------------------------------------------------ */

/* What went wrong in the step that failed, in words. */
static void explain(const beta *self, dal_error *error, int status)
{
    const dal_kernel *const k = &self->kernel;
    const evaluator *const e = &self->motion->mechanics->eval;
    const bool alone =
        k->failure.kind == DAL_FAILED_POTENTIAL && k->potential_ctx != e && !k->at.dragged;
    switch (k->failure.kind) {
    case DAL_FAILED_CONSTRAINT:
        dal__refuse(error, "constraint", k->failure.returned);
        break;
    case DAL_FAILED_POTENTIAL:
    case DAL_FAILED_BALANCE:
        dal__refuse(error, alone ? "potential" : e->refused, k->failure.returned);
        break;
    case DAL_FAILED_STEADY:
        dal__fail(error, status, "the system is declared steady, but a reaction changed mu within "
                  "the step, because it pushes a coordinate that mu depends on; do not declare it "
                  "steady");
        break;
    case DAL_FAILED_FINISH: /* who failed has said why */
        break;
    }
}

/* Whether V_q at the start of the next step is that of its inputs. */
static bool is_forced(const beta *self)
{
    const size_t inputs = self->motion->system->def.inputs;
    for (size_t i = 0; i < inputs; i++)
        if (self->input[i] != self->kernel.input[i]) return false;
    return self->kernel.forced;
}

static int advance(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    beta *const self = method;
    self->kernel.forced = is_forced(self);
    self->kernel.t0 = motion->t0;
    self->kernel.h = motion->h;
    self->kernel.number = motion->steps - motion->first;
    self->kernel.estimate = motion->estimate;
    dal__copy(motion->system->def.inputs, self->kernel.input, self->input);
    const int status = self->advance(&self->kernel, steps, done);
    if (status) explain(self, motion->error, status);
    return status;
}

static int estimates(void *method, int *q, double *noise, dal_error *error)
{
    beta *const self = method;
    const dal__composition of = {.substep = self->substep, .stages = self->kernel.stages,
                                .ends = self->ends, .order = self->motion->scheme->order};
    const int status = dal__embedded_weights(&of, self->weight, q, error);
    self->kernel.weight = self->weight;
    *noise = *q > 0 ? dal__sum_of_sizes(self->kernel.stages + 1, self->weight) : 0.0;
    return status;
}

static void rescale(void *method, double ratio)
{
    dal_kernel_rescale(&((beta *)method)->kernel, ratio);
}

/* Momenta; with them what the Lagrangian pushes with is evaluated again. */
static void forget_velocity(void *method) { ((beta *)method)->kernel.carried = false; }

/* The predictor of the step routine: the pulls and V_q of the last stages, and, where there are
 * momenta, p and the changes of v; and what x lacks.  What the flags call unknown is 0: a step that
 * failed may have left anything there. */
static size_t save(const void *method, double *values)
{
    const beta *const self = method;
    const dal_kernel *const k = &self->kernel;
    const size_t n = k->n, flags = 3 + k->kinds;
    const size_t count = flags + 6 * n + (k->momentum ? n + 4 * n * k->kinds + k->m + 1 : 0);
    if (!values) return count;
    double *const vectors = values + flags;
    const bool forced = is_forced(self);
    memset(values, 0, count * sizeof *values);
    values[0] = k->history_known;
    values[1] = forced;
    values[2] = k->carried;
    for (size_t i = 0; i < k->kinds; i++) values[3 + i] = k->known[i];
    memcpy(vectors, k->at.dv_history, 5 * n * sizeof *values); /* and residue */
    if (forced) memcpy(vectors + 5 * n, k->force0, n * sizeof *values);
    if (k->carried) memcpy(vectors + 6 * n, k->momentum, n * sizeof *values);
    for (size_t i = 0; i < k->kinds; i++)
        memcpy(vectors + (7 + 4 * i) * n, k->history + 4 * i * n, k->known[i] * n * sizeof *values);
    const bool begun = k->kinds > 0 && k->known[0] > 0; /* which the first stage makes so */
    if (k->momentum) values[count - 1] = begun ? k->latest_span : 1.0;
    if (begun) memcpy(values + count - 1 - k->m, k->latest, k->m * sizeof *values);
    return count;
}

static int accepts(const void *method, const double *values)
{
    const dal_kernel *const k = &((const beta *)method)->kernel;
    for (size_t i = 0; i < 3 + k->kinds; i++) {
        const double most = i < 3 ? 1.0 : 4.0;
        if (!(values[i] >= 0.0 && values[i] <= most && values[i] == floor(values[i]))) return false;
    }
    if (!k->momentum) return values[2] == 0.0;
    return values[3 + k->kinds + (7 + 4 * k->kinds) * k->n + k->m] != 0.0; /* a span */
}

static void restore(void *method, const double *values)
{
    beta *const self = method;
    dal_kernel *const k = &self->kernel;
    const size_t n = k->n;
    const double *const vectors = values + 3 + k->kinds;
    if (isfinite(k->range[1])) take_range(k, self->motion); /* else the steps look by themselves */
    dal__copy(self->motion->system->def.inputs, k->input, self->input);
    k->history_known = values[0] != 0.0;
    k->forced = values[1] != 0.0;
    k->carried = values[2] != 0.0;
    for (size_t i = 0; i < k->kinds; i++) k->known[i] = (unsigned char)values[3 + i];
    memcpy(k->at.dv_history, vectors, 5 * n * sizeof *values);
    memcpy(k->force0, vectors + 5 * n, n * sizeof *values);
    if (!k->momentum) return;
    memcpy(k->momentum, vectors + 6 * n, n * sizeof *values);
    memcpy(k->history, vectors + 7 * n, 4 * n * k->kinds * sizeof *values);
    memcpy(k->latest, vectors + (7 + 4 * k->kinds) * n, k->m * sizeof *values);
    k->latest_span = vectors[(7 + 4 * k->kinds) * n + k->m];
}

dal_kernel *dal__beta_kernel(const dal_stepper *stepper)
{
    return stepper->family->advance == advance ? &((beta *)stepper->method)->kernel : NULL;
}

void dal__beta_take_inputs(const dal_stepper *stepper)
{
    beta *const self = stepper->method;
    dal__copy(self->motion->system->def.inputs, self->kernel.input, self->input);
}

void dal__beta_any_sizes(dal_stepper *stepper)
{
    beta *const self = stepper->method;
    const dal_system *const system = self->motion->system;
    self->advance = dal__kernel_any(dal__has_momenta(system));
}

const dal_family dal__family_beta = {
    .name = "beta",
    .schemes = dal__beta_records,
    .count = DAL__BETA_RECORDS,
    .parse = dal__beta_parse,
    .help = "a number in [0, 1], beta (also with -nodes)",
    .make = make,
    .free = release,
    .start = start,
    .advance = advance,
    .save = save,
    .accepts = accepts,
    .restore = restore,
    .estimates = estimates,
    .rescale = rescale,
    .forget_velocity = forget_velocity,
};
