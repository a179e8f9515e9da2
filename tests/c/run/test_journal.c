/* Journals: what the file holds at every moment at which a process may die, going on from there,
 * damage, failures of the disk, and who may write.
 *
 * The calls that change a file go through this program (--wrap): it can image the file before each
 * of them and after half of it, or let one of them fail. */
#define _DEFAULT_SOURCE
#include "fixtures.h"
#include "check.h"

#include "dalembert/events.h"
#include "dalembert/journal.h"
#include "run/run.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

enum { N = 3, MOST_ROWS = 80, MOST_EVENTS = 40, WIDTH = 2, IMAGES = 2000 };

static char folder[64];

static const char *in_folder(const char *name)
{
    static char paths[4][128];
    static int next;
    char *const path = paths[next++ % 4];
    snprintf(path, sizeof paths[0], "%s/%s", folder, name);
    return path;
}

/* ---- systems ------------------------------------------------------------------------------- */

static const double mass[9] = {2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.75};
static const double start[6] = {0.3, -0.2, 0.4, 0.92106099400288508, 0.38941834230865049, 1.1};

static double silent_from = 1e9; /* a time after which the motors fail */

static int motors(double t, const double *q, const double *v, const double *u, double *f,
                  double *f_q, double *f_v, void *ctx)
{
    if (t > silent_from) return 1;
    if (f) memcpy(f, (double[]){u[0] * cos(q[2]) - 0.1 * v[0], u[0] * sin(q[2]), u[1]},
                  N * sizeof *f);
    if (f_q) memset(f_q, 0, 9 * sizeof *f_q);
    if (f_v) memset(f_v, 0, 9 * sizeof *f_v);
    return 0;
}

static dal_system *open_cart(double heavier)
{
    double M[9];
    memcpy(M, mass, sizeof M);
    M[8] += heavier;
    const dal_system_def def = {.n = N, .m = 1, .mass = M, .constraint = plane_blade,
                                .force = motors,
                                .inputs = WIDTH, .name = "cart", .state = start,
                                .missing = DAL_MISSING_F_Q | DAL_MISSING_F_V};
    return new_system(&def);
}

/* A cart with I(q) = 1 + sin(x + theta)/3: where M depends on q, the bits of a step depend on what
 * the steps before have left to its predictor. */
static int turning(double t, const double *q, const double *v, double *L, double *L_q, double *L_v,
                   double *L_qq, double *L_vq, double *L_vv, double *L_vt, void *ctx)
{
    const double inertia = 1.0 + sin(q[0] + q[2]) / 3.0, slope = cos(q[0] + q[2]) / 3.0;
    if (L) *L = 0.5 * (v[0] * v[0] + v[1] * v[1] + inertia * v[2] * v[2]) - 0.2 * cos(q[2]);
    if (L_q) {
        L_q[0] = 0.5 * slope * v[2] * v[2];
        L_q[1] = 0.0;
        L_q[2] = L_q[0] + 0.2 * sin(q[2]);
    }
    if (L_v) memcpy(L_v, (double[]){v[0], v[1], inertia * v[2]}, N * sizeof *L_v);
    return 0;
}

static dal_system *open_wagon(void)
{
    const dal_system_def def = {.n = N, .m = 1, .lagrangian = turning, .constraint = plane_blade,
                                .force = motors, .inputs = WIDTH, .name = "wagon", .state = start,
                                .missing = DAL_MISSING_F_Q | DAL_MISSING_F_V | DAL_MISSING_L_QQ
                                         | DAL_MISSING_L_VQ | DAL_MISSING_L_VV};
    return new_system(&def);
}

static int wall(double t, const double *x, double *g, void *ctx)
{
    *g = x[0] - 0.6;
    return 0;
}

static int bounce(double t, double *x, void *ctx)
{
    for (size_t i = 3; i < 6; i++) x[i] = -x[i];
    return 0;
}

static int turned(double t, const double *x, double *g, void *ctx)
{
    *g = sin(3.0 * x[2]);
    return 0;
}

static int late(double t, const double *x, double *g, void *ctx)
{
    *g = t - 1.87;
    return 0;
}

/* A controller of its own state and time. */
static int control(size_t step, double t, const double *x, double *u, void *ctx)
{
    u[0] = 0.5 - x[0];
    u[1] = sin(5.0 * t) + 0.1 * (double)step;
    return 0;
}

/* ---- runs ---------------------------------------------------------------------------------- */

typedef struct plan {
    const char *system, *scheme;
    size_t steps, stride, hold;
    bool table, controlled, watched, terminal, timed;
    double tolerance; /* of error-controlled steps to t = 3.5, whose hold is in units of 0.05 */
    double eps;       /* of reversible ones */
} plan;

static const plan plans[] = {
    {"cart", "midpoint-suzuki4", 60, 4, 3, .table = true},
    {"cart", "leapfrog", 60, 1, 1, .controlled = true, .watched = true},
    {"cart", "midpoint", 60, 3, 7, .controlled = true, .watched = true, .terminal = true},
    {"cart", "midpoint", 60, 3, 1, .controlled = true, .watched = true, .terminal = true},
    {"cart", "leapfrog-kl6", 60, 2, 0, .watched = true, .timed = true},
    {"cart", "leapfrog", 60, 2, 0, .watched = true, .timed = true, .terminal = true},
    {"cart", "leapfrog", 60, 3, 2, .controlled = true, .timed = true},
    {"disk", "leapfrog-kl6", 60, 2, 0, .table = false},
    {"particle", "midpoint-nodes", 60, 3, 0, .table = false},
    {"cart", "0.3-nodes", 60, 2, 0, .watched = true},
    {"wagon", "0.3-nodes", 60, 2, 0, .watched = true},
    {"wagon", "leapfrog", 60, 2, 1, .controlled = true, .watched = true},
    {"disk", "pair:0:1", 40, 1, 0, .table = false},
    {"sleigh", "reference", 20, 1, 0, .table = false},
    {"sleigh", "leapfrog", 60, 60, 0, .table = false},
    {"cart", "midpoint-suzuki4", 1000, 4, 3, .table = true, .tolerance = 1e-3},
    {"cart", "leapfrog-kl6", 1000, 1, 7, .controlled = true, .watched = true, .tolerance = 1e-4},
    {"cart", "leapfrog-kl6", 1000, 3, 5, .controlled = true, .watched = true, .terminal = true,
     .tolerance = 1e-4},
    {"cart", "leapfrog-kl6", 1000, 2, 0, .watched = true, .timed = true, .tolerance = 1e-4},
    {"disk", "leapfrog-kl8", 1000, 2, 0, .tolerance = 1e-8},
    {"particle_oscillator", "bm6", 1000, 2, 0, .eps = 0.1},
};

typedef struct happening {
    size_t event, step;
    double t, x[8], after[8];
    bool reset;
} happening;

/* All that a run is made of, and makes. */
typedef struct outcome {
    dal_system *system;
    dal_stepper *stepper;
    dal_events *events;
    dal_run run;
    size_t n, m;
    double x[MOST_ROWS * 8], reactions[MOST_ROWS * 2], inputs[MOST_ROWS * WIDTH];
    double row_times[MOST_ROWS], times[MOST_ROWS], at[MOST_ROWS * 8];
    happening happened[MOST_EVENTS];
    size_t happenings;
} outcome;

static int note(size_t event, size_t step, double t, const double *x, const double *after,
                void *ctx)
{
    outcome *const o = ctx;
    happening *const h = &o->happened[o->happenings++];
    memset(h, 0, sizeof *h);
    *h = (happening){.event = event, .step = step, .t = t, .reset = after != NULL};
    memcpy(h->x, x, 2 * o->n * sizeof *x);
    if (after) memcpy(h->after, after, 2 * o->n * sizeof *x);
    return 0;
}

/* The run of a plan; started, unless it is to be resumed. */
static void set_up(outcome *o, const plan *p, bool starts, double heavier)
{
    memset(o, 0, sizeof *o);
    const bool is_cart = strcmp(p->system, "cart") == 0;
    const dal_scheme scheme = find_scheme(p->scheme);
    double x[8];
    const bool is_wagon = strcmp(p->system, "wagon") == 0;
    o->system = is_cart ? open_cart(heavier) : is_wagon ? open_wagon() : open_system(p->system);
    o->n = dal_system_n(o->system);
    o->m = dal_system_m(o->system);
    o->stepper =
        open_stepper(o->system, &scheme,
                     &(dal_options){.tolerance = p->tolerance, .eps = p->eps});
    const bool varies = p->tolerance > 0.0 || p->eps > 0.0;
    need(dal_system_state(o->system, x), "state", "");
    if (starts)
        need(dal_stepper_start(o->stepper, 0.5, varies ? (double)INFINITY : 0.05, x,
                               DAL_CHECK,
                               scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT
                                                              : DAL_INITIAL_NONE),
             p->scheme, dal_stepper_error(o->stepper)->text);
    const dal_event list[] = {{.g = wall, .direction = 1, .reset = bounce}, {.g = turned},
                              {.g = late, .terminal = 1}};
    dal_error error = {0};
    const size_t count = !p->watched ? 0 : p->terminal ? 3 : 2;
    if (p->watched || p->timed)
        need(dal_events_new(&o->events, o->stepper, &scheme, list, count, &error), "events",
             error.text);
    for (size_t k = 0; k < MOST_ROWS; k++) {
        o->times[k] = 0.5 + 0.047 * (double)k;
        for (size_t i = 0; i < WIDTH && p->table; i++)
            o->inputs[k * WIDTH + i] = sin(1.0 + (double)(k * WIDTH + i));
    }
    o->run = (dal_run){.stepper = o->stepper, .steps = p->steps, .stride = p->stride,
                       .unchecked = 1, /* a restart discards the estimate */
                       .input_steps = p->hold, .x = p->timed ? NULL : o->x,
                       .reactions = p->timed ? NULL : o->reactions,
                       .inputs = p->table || p->controlled ? o->inputs : NULL,
                       .control = p->controlled ? control : NULL, .events = o->events,
                       .happened = o->events ? note : NULL, .happened_ctx = o,
                       .times = p->timed ? o->times : NULL, .time_count = p->timed ? MOST_ROWS : 0,
                       .x_at_times = p->timed ? o->at : NULL};
    if (varies) {
        o->run.until = 3.5;
        o->run.input_duration = 0.05 * (double)p->hold;
        o->run.row_times = p->timed ? NULL : o->row_times;
    }
    if (p->timed && varies) o->run.time_count = 60;
    else if (p->timed) o->run.time_count = (size_t)((double)p->steps * 0.05 / 0.047);
}

static void tear_down(outcome *o)
{
    dal_journal_free(o->run.journal);
    dal_events_free(o->events);
    release(o->system);
}

static bool is_over(int status, const dal_run *run)
{
    return status != DAL_SUCCESS || dal__run_is_over(run);
}

/* To the end, so many steps in a call. */
static int go(outcome *o, size_t budget)
{
    int status;
    do status = dal_run_go(&o->run, budget);
    while (!is_over(status, &o->run));
    return status;
}

static void check_same(const outcome *a, const outcome *b)
{
    const size_t N2 = 2 * a->n;
    CHECK(a->run.done == b->run.done && a->run.stored == b->run.stored);
    CHECK(a->run.times_done == b->run.times_done && a->run.ended == b->run.ended);
    CHECK((!a->run.ended || a->run.t_end == b->run.t_end) && a->happenings == b->happenings);
    CHECK(memcmp(a->x, b->x, sizeof a->x) == 0);
    CHECK(memcmp(a->reactions, b->reactions, sizeof a->reactions) == 0);
    CHECK(memcmp(a->inputs, b->inputs, sizeof a->inputs) == 0);
    CHECK(memcmp(a->at, b->at, sizeof a->at) == 0);
    CHECK(memcmp(a->row_times, b->row_times, sizeof a->row_times) == 0);
    CHECK(memcmp(a->happened, b->happened, sizeof a->happened) == 0);
    CHECK(memcmp(dal_stepper_state(a->stepper), dal_stepper_state(b->stepper),
                 N2 * sizeof(double)) == 0);
    dal_stats one, other;
    dal_stepper_stats(a->stepper, &one);
    dal_stepper_stats(b->stepper, &other);
    CHECK(memcmp(&one, &other, sizeof one) == 0);
}

/* ---- what a file holds ---------------------------------------------------------------------- */

static void check_row(const outcome *whole, const dal_record *r)
{
    const size_t N2 = 2 * whole->n, m = whole->m;
    CHECK(memcmp(r->x, whole->x + r->number * N2, N2 * sizeof *r->x) == 0);
    if (r->number > 0)
        CHECK(memcmp(r->reaction, whole->reactions + (r->number - 1) * m, m * sizeof *r->x) == 0);
}

/* Every record is what the run has made; at least so many rows.  Returns whether it opens. */
static bool check_file(const char *path, const outcome *whole, size_t rows, dal_error *error)
{
    dal_journal *journal;
    dal_journal_info info;
    size_t row = 0, event = 0, timed = 0;
    const size_t N2 = 2 * whole->n;
    if (dal_journal_open(&journal, path, 0, NULL, error)) return false;
    dal_journal_describe(journal, &info);
    CHECK(info.n == whole->n && info.m == whole->m && info.t0 == 0.5);
    const bool controlled = dal__run_varies(&whole->run);
    CHECK(info.h == (controlled ? 0.0 : 0.05));
    for (size_t i = 0; i < info.records; i++) {
        dal_record r;
        CHECK(dal_journal_read(journal, i, &r, error) == DAL_SUCCESS);
        CHECK(r.kind != DAL_RECORD_RESET || i + 1 < info.records); /* with the state after it */
        const happening *const h = &whole->happened[event];
        switch ((dal_record_kind)r.kind) {
        case DAL_RECORD_ROW:
        case DAL_RECORD_END:
            if (!info.has_rows) {
                CHECK(r.kind == DAL_RECORD_END && r.t == whole->run.t_end);
                break;
            }
            CHECK(r.number == row++);
            if (info.has_times) break; /* it is there for its inputs, which resume compares */
            check_row(whole, &r);
            if (controlled) CHECK(r.t == whole->row_times[r.number]);
            else if (r.kind == DAL_RECORD_END) CHECK(r.t == whole->run.t_end);
            else CHECK_NEAR(r.t, 0.5 + 0.05 * (double)(r.number * info.stride), 1e-14);
            break;
        case DAL_RECORD_TIME:
            CHECK(r.number == timed && r.t == whole->times[timed]);
            CHECK(memcmp(r.x, whole->at + timed * N2, N2 * sizeof *r.x) == 0);
            timed++;
            break;
        case DAL_RECORD_EVENT:
        case DAL_RECORD_RESET:
            CHECK(r.number == h->event && r.step == h->step && r.t == h->t);
            CHECK((r.kind == DAL_RECORD_RESET) == h->reset);
            CHECK(memcmp(r.x, h->x, N2 * sizeof *r.x) == 0);
            if (!h->reset) event++;
            break;
        case DAL_RECORD_AFTER:
            CHECK(memcmp(r.x, h->after, N2 * sizeof *r.x) == 0);
            event++;
            break;
        }
    }
    CHECK((info.has_times ? timed : row) >= rows);
    dal_journal_free(journal);
    return true;
}

/* The run goes on from a file to the bits of the whole one, in two parts. */
static bool resume(const char *path, const plan *p, const outcome *whole, dal_error *error)
{
    static outcome o;
    int status = DAL_SUCCESS;
    for (int part = 0; part < 2 && !status; part++) {
        dal_journal *journal;
        set_up(&o, p, false, 0.0);
        status = dal_journal_open(&journal, path, 1, NULL, error);
        if (!status) {
            status = dal_journal_resume(journal, &o.run, error);
            if (status) dal_journal_free(journal);
        }
        if (status) break;
        if (part == 1) {
            status = go(&o, 17);
            CHECK(dal_journal_error(journal)->status == DAL_SUCCESS);
            check_same(&o, whole);
        } else {
            const int returned = dal_run_go(&o.run, 5);
            CHECK(returned == DAL_SUCCESS || o.run.ended);
        }
        if (part == 1) status = DAL_SUCCESS;
        if (part == 0) tear_down(&o);
    }
    tear_down(&o);
    return status == DAL_SUCCESS;
}

/* ---- the moments at which a process may die -------------------------------------------------- */

static struct {
    bool imaging;
    long fails_at;         /* a call of a file changes nothing and fails, counted down from here */
    int code;
    const plan *plan;
    const outcome *whole;
    size_t acknowledged, images;
} world = {.fails_at = -1};

static void copy(int from, const char *path, size_t extra, const void *bytes, off_t where)
{
    static char buffer[1 << 16];
    const int to = open(path, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    ssize_t got;
    for (off_t at = 0; (got = pread(from, buffer, sizeof buffer, at)) > 0; at += got)
        if (write(to, buffer, (size_t)got) != got) abort();
    if (extra > 0 && (lseek(to, where, SEEK_SET) < 0 || write(to, bytes, extra) != (ssize_t)extra))
        abort();
    close(to);
}

/* What the file is if the process dies now, with so much of the call made. */
static void image(int file, size_t extra, const void *bytes, off_t where)
{
    const char *const path = in_folder("image");
    dal_error error = {0};
    world.imaging = false;
    copy(file, path, extra, bytes, where);
    CHECK(check_file(path, world.whole, world.acknowledged, &error));
    CHECK(resume(path, world.plan, world.whole, &error));
    CHECK(check_file(path, world.whole, world.whole->run.stored, &error));
    world.images++;
    world.imaging = true;
}

ssize_t __real_pwrite64(int file, const void *bytes, size_t size, off_t where);
ssize_t __wrap_pwrite64(int file, const void *bytes, size_t size, off_t where);
int __real_ftruncate64(int file, off_t size);
int __wrap_ftruncate64(int file, off_t size);
int __real_fdatasync(int file);
int __wrap_fdatasync(int file);

static bool fails(void)
{
    if (world.fails_at < 0 || world.fails_at-- > 0) return false;
    world.fails_at = 0; /* and so do all that follow */
    errno = world.code;
    return true;
}

ssize_t __wrap_pwrite64(int file, const void *bytes, size_t size, off_t where)
{
    if (fails()) { /* a full disk takes what it can */
        const size_t half = size / 2;
        return world.fails_at == 0 && half > 0 && world.code == ENOSPC && size % 16 == 0
                   ? (world.code = EDQUOT, __real_pwrite64(file, bytes, half, where)) : -1;
    }
    if (world.imaging) {
        image(file, 0, NULL, 0);
        image(file, size / 2, bytes, where);
    }
    return __real_pwrite64(file, bytes, size, where);
}

int __wrap_ftruncate64(int file, off_t size)
{
    if (world.imaging) image(file, 0, NULL, 0);
    return __real_ftruncate64(file, size);
}

int __wrap_fdatasync(int file)
{
    if (fails()) return -1;
    if (world.imaging) image(file, 0, NULL, 0);
    return 0; /* the disk itself is not what is tested */
}

int __real_flock(int file, int kind);
int __wrap_flock(int file, int kind);
static int no_locks; /* what a file system without locks says */

int __wrap_flock(int file, int kind)
{
    if (no_locks == 0) return __real_flock(file, kind);
    errno = no_locks;
    return -1;
}

static dal_journal *begin(outcome *o, const plan *p, const char *path, int goes_on)
{
    dal_journal *journal = NULL;
    dal_error error = {0};
    const dal_scheme scheme = find_scheme(p->scheme);
    const dal_journal_options options = {.seconds = -1.0, .goes_on = goes_on,
                                         .description = "what it is", .description_size = 10};
    set_up(o, p, true, 0.0);
    unlink(path);
    need(dal_journal_new(&journal, path, &o->run, &scheme, &options, &error), path, error.text);
    return journal;
}

static void check_every_moment(const plan *p, size_t budget)
{
    static outcome whole, o;
    set_up(&whole, p, true, 0.0);
    go(&whole, SIZE_MAX);
    CHECK(whole.run.ended == p->terminal);
    CHECK((whole.happenings > 0) == p->watched);
    begin(&o, p, in_folder("run"), 0);
    world.imaging = true;
    world.plan = p;
    world.whole = &whole;
    world.acknowledged = 0;
    int status;
    do {
        status = dal_run_go(&o.run, budget);
        world.acknowledged = p->timed ? o.run.times_done : o.run.stored;
    } while (!is_over(status, &o.run));
    world.imaging = false;
    check_same(&o, &whole);
    tear_down(&o);
    dal_error error = {0};
    CHECK(check_file(in_folder("run"), &whole, whole.run.stored, &error));
    tear_down(&whole);
}

/* ---- damage -------------------------------------------------------------------------------- */

static void write_file(const char *path, const char *bytes, size_t size)
{
    const int file = open(path, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    if (write(file, bytes, size) != (ssize_t)size) abort();
    close(file);
}

/* A small journal with each of its bytes flipped, and cut off at each: an error with words, or what
 * the run has made; and what goes on from it is the run. */
static void test_damage(void)
{
    const plan p = {"cart", "leapfrog", 12, 2, 1, .controlled = true, .watched = true};
    static outcome whole, o;
    static char bytes[1 << 14], changed[1 << 14];
    set_up(&whole, &p, true, 0.0);
    go(&whole, SIZE_MAX);
    begin(&o, &p, in_folder("small"), 0);
    go(&o, 3);
    tear_down(&o);
    const int file = open(in_folder("small"), O_RDONLY);
    const size_t size = (size_t)read(file, bytes, sizeof bytes);
    close(file);
    CHECK(size > 1000 && size < sizeof bytes);
    size_t opened = 0, resumed = 0, refused = 0;
    for (size_t k = 0; k < 2 * size; k += brief() ? 9 : 1) {
        const bool cuts = k >= size;
        dal_error error = {0};
        memcpy(changed, bytes, size);
        if (!cuts) changed[k] ^= (char)(1 << k % 8);
        write_file(in_folder("changed"), changed, cuts ? k - size : size);
        if (check_file(in_folder("changed"), &whole, 0, &error)) {
            opened++;
            if (resume(in_folder("changed"), &p, &whole, &error)) resumed++;
            else CHECK(error.status == DAL_EUNSUPPORTED && error.text[0] != '\0');
        } else {
            refused++;
            CHECK((error.status == DAL_EINVAL || error.status == DAL_EIO) && error.text[0]);
        }
    }
    printf("# %zu bytes: %zu open, %zu go on, %zu are refused\n", size, opened, resumed, refused);
    CHECK((opened + refused == 2 * size && resumed > size / 2) || brief());
    tear_down(&whole);
}

/* A record that stands elsewhere, or is of another journal, is none. */
static void test_strangers(void)
{
    const plan p = {"sleigh", "leapfrog", 12, 1, 0, .table = false};
    static outcome o;
    static char bytes[2][1 << 14], changed[1 << 14];
    size_t size = 0;
    dal_journal *journal;
    dal_journal_info info = {0};
    dal_error error = {0};
    for (int k = 0; k < 2; k++) {
        begin(&o, &p, in_folder("stranger"), 0);
        go(&o, 3);
        tear_down(&o);
        const int file = open(in_folder("stranger"), O_RDONLY);
        size = (size_t)read(file, bytes[k], sizeof bytes[k]);
        close(file);
    }
    need(dal_journal_open(&journal, in_folder("stranger"), 0, NULL, &error), "open", error.text);
    dal_journal_describe(journal, &info);
    dal_journal_free(journal);
    for (int k = 0; k < 2; k++) {
        memcpy(changed, bytes[1], size);
        memcpy(changed + info.begin + 5 * info.size, bytes[k] + info.begin + (4u + !k) * info.size,
               info.size);
        write_file(in_folder("stranger"), changed, size);
        need(dal_journal_open(&journal, in_folder("stranger"), 0, NULL, &error), "open", "");
        dal_journal_describe(journal, &info);
        CHECK(info.records == 5 && info.cut == 8 * info.size);
        dal_journal_free(journal);
    }
}

/* Of the two last snapshots one is enough, not to go back to the beginning. */
static void test_slots(void)
{
    const plan p = {"sleigh", "leapfrog", 12, 1, 0, .table = false};
    static outcome o;
    static char bytes[1 << 14];
    dal_error error = {0};
    begin(&o, &p, in_folder("slots"), 0);
    go(&o, 3); /* four calls, and a snapshot at the end of each */
    const size_t slot = sizeof(double) * (dal_stepper_saved(o.stepper) + 4 + 1) + 48;
    tear_down(&o);
    dal_journal *journal;
    dal_journal_info info;
    need(dal_journal_open(&journal, in_folder("slots"), 0, NULL, &error), "open", error.text);
    dal_journal_describe(journal, &info);
    CHECK(info.done == 12);
    dal_journal_free(journal);
    const int file = open(in_folder("slots"), O_RDONLY);
    const size_t size = (size_t)read(file, bytes, sizeof bytes);
    close(file);
    size_t later = 0;
    for (size_t k = 1; k <= 2; k++) {
        char *const byte = bytes + info.begin - k * slot + 20;
        *byte ^= 1;
        write_file(in_folder("slots"), bytes, size);
        *byte ^= 1;
        need(dal_journal_open(&journal, in_folder("slots"), 0, NULL, &error), "open", error.text);
        dal_journal_describe(journal, &info);
        CHECK(info.done == 12 || info.done == 9);
        later += info.done == 12;
        dal_journal_free(journal);
    }
    CHECK(later == 1);
}

/* ---- other files --------------------------------------------------------------------------- */

static void test_refused(void)
{
    const plan *const p = &plans[1];
    static outcome o;
    dal_journal *journal, *second;
    dal_error error = {0};
    const dal_scheme scheme = find_scheme(p->scheme), other = find_scheme("midpoint");
    const char *const path = in_folder("refused");

    journal = begin(&o, p, path, 0);
    CHECK(dal_journal_open(&second, path, 1, NULL, &error) == DAL_EINVAL);
    char self[40];
    snprintf(self, sizeof self, "process %ld on ", (long)getpid());
    CHECK(strstr(error.text, self) && strstr(error.text, "writes it"));
    CHECK(dal_journal_open(&second, path, 0, NULL, &error) == DAL_SUCCESS);
    dal_journal_info info;
    dal_journal_describe(second, &info);
    CHECK(info.is_written && info.steps == p->steps && info.done == 0 && info.records == 0);
    CHECK(info.description_size == 10 && memcmp(info.description, "what it is", 10) == 0);
    CHECK(strcmp(info.scheme, p->scheme) == 0);
    dal_record r;
    CHECK(dal_journal_read(second, 0, &r, &error) == DAL_EINVAL);
    dal_run run = o.run;
    CHECK(dal_journal_resume(second, &run, &error) == DAL_EINVAL); /* open to be read */
    dal_journal_free(second);
    CHECK(dal_journal_new(&second, path, &o.run, &scheme, NULL, &error) == DAL_EINVAL);
    go(&o, 5);
    tear_down(&o);

    set_up(&o, p, true, 0.0);
    CHECK(dal_journal_new(&journal, path, &o.run, &scheme, NULL, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "the file exists already"));
    CHECK(dal_journal_new(&journal, in_folder("a"), &o.run, &other, NULL, &error) == DAL_EINVAL);
    CHECK(dal_journal_new(&journal, in_folder("no/a"), &o.run, &scheme, NULL, &error) == DAL_EIO);
    CHECK(strstr(error.text, "No such file or directory"));
    CHECK(o.run.journal == NULL && access(in_folder("a"), F_OK) != 0);
    CHECK(dal_journal_new(NULL, path, &o.run, &scheme, NULL, &error) == DAL_EINVAL);
    CHECK(dal_journal_open(&journal, in_folder("none"), 0, NULL, &error) == DAL_EIO);
    write_file(in_folder("text"), "not a journal, but more than two hundred bytes", 46);
    CHECK(dal_journal_open(&journal, in_folder("text"), 0, NULL, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "not the journal of a run"));
    tear_down(&o);

    dal_system *const sleigh = open_system("sleigh");
    const dal_flow_scheme adams = {.method = DAL_FLOW_MSADAMS};
    dal_scheme flow = find_scheme("reference");
    flow.data = &adams;
    dal_stepper *const stepper = open_stepper(sleigh, &flow, NULL);
    double x[6];
    need(dal_system_state(sleigh, x), "state", "");
    need(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE), "start", "");
    run = (dal_run){.stepper = stepper, .steps = 4, .stride = 1};
    CHECK(dal_journal_new(&journal, in_folder("b"), &run, &flow, NULL, &error)
          == DAL_EUNSUPPORTED);
}

/* Where there are no locks, there are none; where there are and they fail, nothing is written. */
static void test_no_locks(void)
{
    const plan *const p = &plans[1];
    static outcome whole, o;
    dal_error error = {0};
    set_up(&whole, p, true, 0.0);
    go(&whole, SIZE_MAX);
    for (int k = 0; k < 2; k++) {
        no_locks = k == 0 ? ENOSYS : ENOLCK;
        begin(&o, p, in_folder("unlocked"), 0);
        dal_run_go(&o.run, 20);
        tear_down(&o);
        CHECK(check_file(in_folder("unlocked"), &whole, 21, &error));
        CHECK(resume(in_folder("unlocked"), p, &whole, &error));
    }
    tear_down(&whole);
    no_locks = EIO;
    dal_journal *journal;
    CHECK(dal_journal_open(&journal, in_folder("unlocked"), 1, NULL, &error) == DAL_EIO);
    CHECK(strstr(error.text, "locking: "));
    no_locks = 0;
}

/* A run that is not the one of the journal. */
static void test_other_runs(void)
{
    const plan *const p = &plans[0];
    static outcome o;
    dal_error error = {0};
    const char *const path = in_folder("other");
    begin(&o, p, path, 0);
    dal_run_go(&o.run, 21);
    tear_down(&o);
    const struct { int what; const char *text; int status; } wrong[] = {
        {0, "stride is 4 in the journal, but 2 in the run", DAL_EINVAL},
        {1, "steps of a row of inputs is 3 in the journal, but 5 in the run", DAL_EINVAL},
        {2, "the number of inputs is 2 in the journal, but 0 in the run", DAL_EINVAL},
        {3, "another system or scheme", DAL_EINVAL},
        {4, "another system or scheme", DAL_EINVAL},
        {5, "inputs[1] of row 2 is ", DAL_EINVAL},
        {6, "contains 21 steps, but the run has only steps = 20", DAL_EINVAL},
    };
    for (size_t k = 0; k < sizeof wrong / sizeof *wrong; k++) {
        plan other = *p;
        if (wrong[k].what == 0) other.stride = 2;
        if (wrong[k].what == 1) other.hold = 5;
        if (wrong[k].what == 2) other.table = false;
        if (wrong[k].what == 4) other.scheme = "leapfrog-suzuki4";
        if (wrong[k].what == 6) other.steps = 20;
        set_up(&o, &other, false, wrong[k].what == 3 ? 0.1 : 0.0);
        if (wrong[k].what == 5) o.inputs[5] += 1e-15;
        dal_journal *journal;
        need(dal_journal_open(&journal, path, 1, NULL, &error), path, error.text);
        CHECK(dal_journal_resume(journal, &o.run, &error) == wrong[k].status);
        CHECK(strstr(error.text, wrong[k].text) != NULL);
        CHECK(o.run.journal == NULL && o.run.done == 0 && o.run.stored == 0);
        dal_journal_free(journal);
        tear_down(&o);
    }
}

/* Rows that are computed again, by something that is not what has made them. */
static int other_control(size_t step, double t, const double *x, double *u, void *ctx)
{
    control(step, t, x, u, ctx);
    u[1] += step > 30 ? 1e-9 : 0.0;
    return 0;
}

static void test_computed_again(void)
{
    const plan p = {"cart", "leapfrog", 60, 1, 1, .controlled = true};
    static outcome o;
    dal_journal *journal = NULL;
    dal_error error = {0};
    const dal_scheme scheme = find_scheme(p.scheme);
    const char *const path = in_folder("again");
    set_up(&o, &p, true, 0.0);
    unlink(path);
    need(dal_journal_new(&journal, path, &o.run, &scheme, NULL, &error), path, error.text);
    dal_run_go(&o.run, 50); /* no snapshot but that of the beginning */
    tear_down(&o);
    for (int k = 0; k < 2; k++) {
        set_up(&o, &p, false, 0.0);
        if (k == 0) o.run.control = other_control;
        need(dal_journal_open(&journal, path, 1, NULL, &error), path, error.text);
        need(dal_journal_resume(journal, &o.run, &error), path, error.text);
        CHECK(o.run.done == 0);
        const int status = go(&o, 7);
        if (k == 0) {
            CHECK(status == DAL_EINVAL && o.run.done == 32);
            CHECK(strstr(dal_stepper_error(o.stepper)->text, "differs from the recomputed one"));
        } else {
            CHECK(status == DAL_SUCCESS);
        }
        tear_down(&o);
    }
}

/* More steps than were planned: the run of so many steps. */
static void test_longer(void)
{
    plan p = plans[1];
    static outcome whole, o;
    dal_error error = {0};
    const char *const path = in_folder("longer");
    p.steps = 20;
    begin(&o, &p, path, 0);
    go(&o, 9);
    tear_down(&o);
    p.steps = 60;
    set_up(&whole, &p, true, 0.0);
    go(&whole, SIZE_MAX);
    CHECK(resume(path, &p, &whole, &error));
    CHECK(check_file(path, &whole, 61, &error));
    tear_down(&whole);
}

/* Resumed in the same stepper and dal_run: the estimate of the first part is not kept. */
static void test_estimate(void)
{
    const plan p = {"sleigh", "leapfrog", 12, 1, 0, .table = false};
    static outcome o;
    dal_stats stats;
    dal_error error = {0};
    dal_journal *journal;
    begin(&o, &p, in_folder("estimate"), 0);
    o.run.unchecked = 0;
    go(&o, SIZE_MAX);
    dal_stepper_stats(o.stepper, &stats);
    CHECK(stats.whole == 1 && stats.error < 0.01);
    dal_journal_free(o.run.journal);
    o.run = (dal_run){.stepper = o.stepper, .steps = 24, .stride = 1, .x = o.x,
                      .reactions = o.reactions};
    need(dal_journal_open(&journal, in_folder("estimate"), 1, NULL, &error), "open", error.text);
    need(dal_journal_resume(journal, &o.run, &error), "resume", error.text);
    dal_stepper_stats(o.stepper, &stats);
    CHECK(o.run.done == 12 && isnan(stats.error) && stats.whole == 0 && stats.remade == 0);
    go(&o, SIZE_MAX);
    dal_stepper_stats(o.stepper, &stats);
    CHECK(o.run.done == 24 && isnan(stats.error) && stats.whole == 0 && stats.remade > 0);
    tear_down(&o);
}

/* ---- a disk that does not take it ------------------------------------------------------------ */

static void test_full_disk(void)
{
    const plan *const p = &plans[1];
    static outcome whole, o;
    dal_error error = {0};
    set_up(&whole, p, true, 0.0);
    go(&whole, SIZE_MAX);
    for (int goes_on = 0; goes_on < 2; goes_on++)
        for (long call = 0; call < 12; call++) {
            dal_journal *const journal = begin(&o, p, in_folder("full"), goes_on);
            world.fails_at = call;
            world.code = ENOSPC;
            size_t acknowledged = 0;
            int status;
            do {
                status = dal_run_go(&o.run, 7);
                if (dal_journal_error(journal)->status == 0) acknowledged = o.run.stored;
            } while (!is_over(status, &o.run));
            world.fails_at = -1;
            CHECK(dal_journal_error(journal)->status == DAL_EIO);
            if (goes_on) {
                CHECK(status == DAL_SUCCESS);
                check_same(&o, &whole);
            } else {
                CHECK(status == DAL_EIO && o.run.done < p->steps);
                CHECK(strstr(dal_stepper_error(o.stepper)->text, "writing: "));
                CHECK(memcmp(o.x, whole.x, o.run.stored * 6 * sizeof *o.x) == 0);
                CHECK(dal_run_go(&o.run, 7) == DAL_EIO); /* and goes on without it, when told so */
                dal_journal_free(journal);
                o.run.journal = NULL;
                CHECK(go(&o, 9) == DAL_SUCCESS);
                check_same(&o, &whole);
            }
            tear_down(&o);
            CHECK(check_file(in_folder("full"), &whole, acknowledged, &error));
            CHECK(resume(in_folder("full"), p, &whole, &error));
        }
    tear_down(&whole);
}

/* A run whose 21st step has failed. */
static void fail_step(outcome *o, const plan *p, double part, int goes_on)
{
    dal_journal *const journal = begin(o, p, in_folder("failed"), goes_on);
    dal_run_go(&o->run, 5);
    silent_from = 0.5 + 0.05 * (20.0 + part);
    CHECK(dal_run_go(&o->run, 40) == DAL_EDOMAIN && o->run.done < 30);
    silent_from = 1e9;
    CHECK(dal_journal_error(journal)->status == DAL_SUCCESS);
}

static void leave(outcome *o)
{
    dal_journal_free(o->run.journal);
    o->run.journal = NULL;
}

/* A step that fails is in no snapshot before the run goes on from it in the same process. */
static void test_failed_step(void)
{
    const plan p = {"cart", "leapfrog-suzuki4", 60, 1, 0, .table = false};
    static outcome whole, o;
    dal_error error = {0};
    set_up(&whole, &p, true, 0.0);
    go(&whole, SIZE_MAX);
    for (int k = 0; k < 20; k++) {
        fail_step(&o, &p, 0.1 + (double)k / 20.0, 0);
        leave(&o);
        CHECK(resume(in_folder("failed"), &p, &whole, &error));
        tear_down(&o);
    }
    tear_down(&whole);
}

/* Then there is one, as the predictor has seen the failure: the run goes on from the file, cut off
 * anywhere, to the bits of the run in which no step failed, or of that which went on. */
static void test_after_failed_step(void)
{
    const plan p = {"wagon", "leapfrog-suzuki4", 60, 1, 0, .table = false};
    static outcome whole, o, later;
    size_t differ = 0;
    set_up(&whole, &p, true, 0.0);
    go(&whole, SIZE_MAX);
    for (int k = 0; k < 12; k += brief() ? 5 : 1)
        for (int calls = 0; calls < 20; calls++) {
            dal_journal *journal;
            fail_step(&o, &p, 0.1 + (double)k / 20.0, 1);
            world.fails_at = calls;
            world.code = ENOSPC;
            CHECK(dal_run_go(&o.run, 5) == DAL_SUCCESS);
            world.fails_at = -1;
            leave(&o);
            go(&o, 7);
            differ += memcmp(o.x, whole.x, sizeof o.x) != 0;
            set_up(&later, &p, false, 0.0);
            need(dal_journal_open(&journal, in_folder("failed"), 1, NULL, NULL), "open", "");
            need(dal_journal_resume(journal, &later.run, NULL), "resume", "");
            CHECK(go(&later, 9) == DAL_SUCCESS);
            CHECK(dal_journal_error(journal)->status == DAL_SUCCESS);
            CHECK(memcmp(later.x, o.x, sizeof o.x) == 0
                  || memcmp(later.x, whole.x, sizeof o.x) == 0);
            tear_down(&later);
            tear_down(&o);
        }
    CHECK(differ > 0);
    tear_down(&whole);
}

static void test_vanished(void)
{
    const plan *const p = &plans[1];
    static outcome o;
    dal_journal *const journal = begin(&o, p, in_folder("gone"), 0);
    CHECK(dal_run_go(&o.run, 5) == DAL_SUCCESS);
    unlink(in_folder("gone"));
    CHECK(dal_run_go(&o.run, 5) == DAL_EIO);
    CHECK(strstr(dal_journal_error(journal)->text, "the file was removed or replaced"));
    tear_down(&o);
}

/* A long call makes snapshots on its way. */
static int count_calls(size_t step, double t, const double *x, void *ctx)
{
    dal_journal_info info;
    dal_journal *journal;
    size_t *const done = ctx;
    if (step % 10000 > 0 || step == 0) return 0;
    need(dal_journal_open(&journal, in_folder("long"), 0, NULL, NULL), "open", "");
    dal_journal_describe(journal, &info);
    CHECK(info.done >= *done && info.done + 4096 + 100 >= step && info.done <= step);
    *done = info.done;
    dal_journal_free(journal);
    return 0;
}

static void test_long_call(void)
{
    const plan p = {"sleigh", "leapfrog", 40000, 100, 0, .table = false};
    static outcome o;
    size_t done = 0;
    set_up(&o, &p, true, 0.0);
    o.run.x = o.run.reactions = NULL;
    o.run.observer = count_calls;
    o.run.observer_ctx = &done;
    dal_journal *journal;
    dal_error error = {0};
    const dal_scheme scheme = find_scheme(p.scheme);
    need(dal_journal_new(&journal, in_folder("long"), &o.run, &scheme,
                         &(dal_journal_options){.seconds = -1.0}, &error), "new", error.text);
    CHECK(dal_run_go(&o.run, SIZE_MAX) == DAL_SUCCESS);
    CHECK(done > 20000);
    dal_record last;
    CHECK(dal_journal_read(journal, 400, &last, &error) == DAL_SUCCESS);
    CHECK(memcmp(last.x, dal_stepper_state(o.stepper), 6 * sizeof(double)) == 0);
    CHECK(isfinite(last.reaction[0]) && last.reaction[0] != 0.0);
    tear_down(&o);
}

int main(void)
{
    snprintf(folder, sizeof folder, "%s/dal-XXXXXX",
             access("/dev/shm", W_OK) == 0 ? "/dev/shm" : ".");
    if (!mkdtemp(folder)) return 1;
    const size_t count = sizeof plans / sizeof *plans;
    for (size_t k = 0; k < count; k++)
        for (size_t budget = 1; budget <= 3; budget += 2) check_every_moment(&plans[k], budget);
    printf("# %zu images\n", world.images);
    CHECK(world.images >= IMAGES);
    test_damage();
    test_strangers();
    test_slots();
    test_refused();
    test_no_locks();
    test_other_runs();
    test_computed_again();
    test_longer();
    test_estimate();
    test_full_disk();
    test_failed_step();
    test_after_failed_step();
    test_vanished();
    test_long_call();
    char command[128];
    snprintf(command, sizeof command, "rm -r %s", folder);
    CHECK(system(command) == 0);
    return check_done();
}
