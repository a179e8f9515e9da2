/* What a run writes into its journal, and how it goes on from there. */
#include "run/journal.h"
#include "run/events.h"
#include "run/run.h"

#include <string.h>

enum { UNSEEN = 4096 };

#define SECONDS 5.0 /* from snapshot to snapshot */

/* ---- what is where ------------------------------------------------------------------------- */

static size_t quotient_up(size_t a, size_t b) { return a / b + (a % b > 0); }

static size_t inputs_of(const dal_run *run)
{
    return run->inputs ? run->stepper->motion.system->def.inputs : 0;
}

/* Counters of events and rows, and the impulse: in a snapshot, after the stepper and the guards. */
static void keep(dal_run *run, dal__archive *a)
{
    dal_events none = {0}, *const e = run->events ? run->events : &none;
    dal__archive_counter(a, &e->doubts);
    dal__archive_counter(a, &e->doubt_event);
    dal__archive_any(a, &e->doubt_t);
    dal__archive_any(a, &e->doubt_g);
    dal__archive_any(a, &run->t_begin);
    dal__archive_any(a, &run->row_time);
    dal__archive_counter(a, &run->row_step);
    dal__archive_counter(a, &run->rows_set);
    dal__archive_counter(a, &run->rows_set_before);
    dal__archive_vector(a, run->stepper->mech.m, run->stepper->motion.impulse);
}

/* The head of a journal of this run, but for what only the caller knows. */
static dal__head head_of(const dal_run *run)
{
    const dal_stepper *const stepper = run->stepper;
    const bool controlled = dal__run_varies(run);
    const size_t m = stepper->mech.m; /* of a controlled step, a row of inputs at most begins */
    const size_t input_rows =
        controlled ? run->stride : quotient_up(run->stride, dal__input_steps(run));
    const size_t events = run->events ? run->events->count : 0;
    const size_t guards = run->events ? dal_events_saved(run->events) : 0;
    dal__head head = {
        .has_rows = run->x || run->inputs || !run->times, .has_times = run->times != NULL,
        .n = stepper->mech.n, .m = m, .inputs = inputs_of(run), .stride = run->stride,
        .input_steps = dal__input_steps(run), .input_rows = input_rows, .events = events,
        .input_duration = controlled && run->inputs ? run->input_duration : 0.0};
    dal__archive a = {.mode = DAL__COUNT, .at = dal_stepper_saved(stepper) + guards};
    keep((dal_run *)run, &a);
    head.snapshot = a.at + dal__times(input_rows, head.inputs);
    return head;
}

/* The rows of inputs whose steps begin since the last row of the run: *count from *first on. */
static void pending_inputs(const dal_run *run, size_t steps, size_t *first, size_t *count)
{
    const size_t input_steps = dal__input_steps(run), row = run->stored > 0 ? run->stored - 1 : 0;
    if (dal__run_varies(run)) {
        *first = run->rows_set_before;
        *count = run->rows_set - run->rows_set_before;
        return;
    }
    *first = quotient_up(row * run->stride, input_steps);
    *count = quotient_up(steps, input_steps) - *first;
}

static void take_inputs(const dal_run *run, size_t steps, double *to)
{
    const size_t width = inputs_of(run);
    size_t first, count;
    if (width == 0) return;
    pending_inputs(run, steps, &first, &count);
    memcpy(to, run->inputs + first * width, count * width * sizeof *to);
}

/* ---- writing ------------------------------------------------------------------------------- */

/* The run fails with the journal. */
static int refuse(const dal_run *run, int status)
{
    if (status && run->journal->error.status == status)
        run->stepper->error = run->journal->error;
    return status;
}

double *dal__journal_reaction(const dal_run *run)
{
    return run->journal ? run->journal->reaction : NULL;
}

int dal__journal_row(const dal_run *run, const double *x, const double *reaction)
{
    dal_journal *const self = run->journal;
    if (!self || !(self->head.has_rows || run->ended)) return DAL_SUCCESS;
    const size_t N = 2 * run->stepper->mech.n, m = run->stepper->mech.m;
    const dal_record_kind kind = run->ended ? DAL_RECORD_END : DAL_RECORD_ROW;
    double *const to =
        dal__journal_next(self, kind, run->stored, run->stepper->motion.steps);
    to[0] = run->ended ? run->t_end : dal_stepper_time(run->stepper);
    memcpy(to + 1, x, N * sizeof *to);
    if (reaction) memcpy(to + 1 + N, reaction, m * sizeof *to);
    if (run->stored > 0) take_inputs(run, run->done + (size_t)run->ended, to + 1 + N + m);
    return refuse(run, dal__journal_add(self));
}

/* A record of a time and a state. */
static int write_state(const dal_run *run, dal_record_kind kind, size_t number, size_t step,
                       double t, const double *x)
{
    double *const to = dal__journal_next(run->journal, kind, number, step);
    to[0] = t;
    memcpy(to + 1, x, 2 * run->stepper->mech.n * sizeof *to);
    return refuse(run, dal__journal_add(run->journal));
}

int dal__journal_event(const dal_run *run, size_t event, size_t step, double t, const double *x,
                       const double *after)
{
    if (!run->journal) return DAL_SUCCESS;
    const dal_record_kind kind = after ? DAL_RECORD_RESET : DAL_RECORD_EVENT;
    int status = write_state(run, kind, event, step, t, x);
    if (!status && after) status = write_state(run, DAL_RECORD_AFTER, event, step, t, after);
    return status;
}

int dal__journal_times(const dal_run *run, size_t before)
{
    const size_t N = 2 * run->stepper->mech.n;
    int status = DAL_SUCCESS;
    for (size_t k = before; run->journal && !status && k < run->times_done; k++)
        status = write_state(run, DAL_RECORD_TIME, k, run->stepper->motion.steps,
                             run->times[k], run->x_at_times + k * N);
    return status;
}

/* Everything that the rest of the run depends on. */
static int save(const dal_run *run)
{
    dal_journal *const self = run->journal;
    const int status = dal_stepper_save(run->stepper, self->snapshot);
    if (status) return status;
    dal__archive a = {.mode = DAL__SAVE, .to = self->snapshot,
                      .at = dal_stepper_saved(run->stepper)};
    if (run->events) {
        dal_events_save(run->events, a.to + a.at);
        a.at += dal_events_saved(run->events);
    }
    keep((dal_run *)run, &a);
    if (!run->ended) take_inputs(run, run->done, a.to + a.at);
    self->mark.steps = run->steps;
    self->mark.done = run->done;
    self->mark.stored = run->stored;
    self->mark.times_done = run->times_done;
    return DAL_SUCCESS;
}

static bool is_due(const dal_journal *self)
{
    const double now = dal__clock();
    return now - self->saved_at >= self->seconds || now < self->saved_at;
}

static int take_snapshot(const dal_run *run)
{
    dal_journal *const self = run->journal;
    int status = self->error.status ? DAL_SUCCESS : save(run);
    if (!status) status = dal__journal_save(self);
    return refuse(run, status);
}

int dal__journal_begin(const dal_run *run)
{
    if (!run->journal || !run->journal->failed) return DAL_SUCCESS;
    run->journal->failed = false;
    return take_snapshot(run);
}

int dal__journal_look(const dal_run *run, size_t made)
{
    dal_journal *const self = run->journal;
    self->unseen += made;
    if (self->unseen < UNSEEN) return DAL_SUCCESS;
    self->unseen = 0;
    return is_due(self) ? take_snapshot(run) : DAL_SUCCESS;
}

int dal__journal_pause(const dal_run *run, int status)
{
    dal_journal *const self = run->journal;
    const bool is_over = status == DAL_STOPPED || dal__run_is_over(run);
    self->failed = status < 0;
    if (status >= 0 && (is_over || is_due(self))) return take_snapshot(run);
    return refuse(run, dal__journal_flush(self));
}

int dal_journal_save(dal_run *run)
{
    if (!run || !run->stepper) return DAL_EINVAL;
    const int status = dal__run_check(run);
    return status || !run->journal ? status : take_snapshot(run);
}

/* ---- making, opening, reading -------------------------------------------------------------- */

static void take_options(dal_journal *self, const dal_journal_options *options)
{
    const double seconds = options ? options->seconds : 0.0;
    self->seconds = seconds == 0.0 ? SECONDS : seconds;
    self->goes_on = options && options->goes_on;
}

static int check_new(const dal_run *run, const dal_scheme *scheme,
                     const dal_journal_options *options, dal_error *error)
{
    if (!run->stepper) return dal__fail(error, DAL_EINVAL, "run->stepper is NULL");
    if (run->done > 0 || run->stored > 0 || run->journal)
        return dal__fail(error, DAL_EINVAL, "the run has already begun, or has a journal: expected "
                         "a new run");
    if (options && options->description_size > 0 && !options->description)
        return dal__fail(error, DAL_EINVAL, "options->description is NULL");
    if (dal__run_check(run)) {
        if (error) *error = run->stepper->error;
        return run->stepper->error.status;
    }
    return dal__stepper_check_scheme(run->stepper, scheme, "a journal", error);
}

int dal_journal_new(dal_journal **journal, const char *path, dal_run *run,
                    const dal_scheme *scheme, const dal_journal_options *options, dal_error *error)
{
    static const dal_journal_options defaults = {0};
    int status = DAL__REQUIRE(error, {"journal", journal}, {"path", path}, {"run", run},
                              {"scheme", scheme});
    if (!status) status = check_new(run, scheme, options, error);
    if (status) return status;
    const dal_journal_options *const with = options ? options : &defaults;
    dal__head head = head_of(run);
    dal_journal *self;
    head.t0 = dal_stepper_time(run->stepper);
    head.h = dal__run_varies(run) ? 0.0 : run->stepper->motion.h;
    head.description_size = with->description_size;
    memcpy(head.fingerprint, with->fingerprint, sizeof head.fingerprint);
    memcpy(head.scheme, scheme->name, sizeof head.scheme);
    head.scheme[sizeof head.scheme - 1] = '\0';
    status = dal__journal_allocate(&self, path, &head, with->description, error);
    if (status) return status;
    take_options(self, options);
    run->journal = self;
    status = save(run);
    if (!status) status = dal__journal_create(self, error);
    if (status) {
        run->journal = NULL;
        dal__journal_detach(self);
        return status;
    }
    *journal = self;
    return DAL_SUCCESS;
}

int dal_journal_open(dal_journal **journal, const char *path, int writes,
                     const dal_journal_options *options, dal_error *error)
{
    int status = DAL__REQUIRE(error, {"journal", journal}, {"path", path});
    dal_journal *self;
    if (!status) status = dal__journal_attach(&self, path, writes != 0, error);
    if (status) return status;
    take_options(self, options);
    if (dal__journal_recall(self)) self->error = (dal_error){0}; /* resume says it again */
    *journal = self;
    return DAL_SUCCESS;
}

void dal_journal_free(dal_journal *journal)
{
    if (!journal) return;
    if (journal->writes) dal__journal_flush(journal);
    dal__journal_detach(journal);
}

void dal_journal_describe(const dal_journal *journal, dal_journal_info *info)
{
    const dal__head *const head = &journal->head;
    *info = (dal_journal_info){
        .n = (size_t)head->n, .m = (size_t)head->m, .inputs = (size_t)head->inputs,
        .stride = (size_t)head->stride, .input_steps = (size_t)head->input_steps,
        .input_rows = (size_t)head->input_rows,
        .events = (size_t)head->events, .has_rows = (int)head->has_rows,
        .has_times = (int)head->has_times, .t0 = head->t0, .h = head->h, .scheme = head->scheme,
        .description = journal->description,
        .description_size = (size_t)head->description_size, .fingerprint = head->fingerprint,
        .steps = (size_t)journal->mark.steps, .done = (size_t)journal->mark.done,
        .records = journal->records, .size = journal->size, .begin = journal->begin,
        .cut = journal->cut, .writer = journal->writer, .is_written = journal->is_written};
}

const dal_error *dal_journal_error(const dal_journal *journal) { return &journal->error; }

/* The record of a number, taken apart. */
static int read_record(dal_journal *self, size_t index, dal_record *record)
{
    const unsigned char *const bytes = dal__journal_record(self, index);
    if (!bytes) return self->error.status;
    const size_t N = 2 * (size_t)self->head.n;
    const double *const x = (const double *)(const void *)(bytes + sizeof(dal__tag)) + 1;
    dal__tag tag;
    memcpy(&tag, bytes, sizeof tag);
    *record = (dal_record){.kind = (int)tag.kind, .number = (size_t)tag.number,
                           .step = (size_t)tag.step, .t = x[-1], .x = x, .reaction = x + N,
                           .input = x + N + self->head.m};
    return DAL_SUCCESS;
}

int dal_journal_read(dal_journal *journal, size_t index, dal_record *record, dal_error *error)
{
    int status = DAL__REQUIRE(error, {"journal", journal}, {"record", record});
    if (status) return status;
    if (index >= journal->records)
        return dal__fail(error, DAL_EINVAL, "index = %zu: expected an index below %zu, the number "
                         "of records", index, journal->records);
    status = dal__journal_flush(journal);
    if (!status) status = read_record(journal, index, record);
    if (status && error) *error = journal->error;
    return status;
}

/* ---- going on ------------------------------------------------------------------------------ */

/* Steps up to the last row of the journal; DAL_EIO. */
static int last_row(dal_journal *self, size_t *steps, dal_error *error)
{
    dal_record r = {0};
    int status = DAL_SUCCESS;
    for (size_t i = self->records; !status && i > 0 && r.kind != DAL_RECORD_ROW; i--)
        status = read_record(self, i - 1, &r);
    if (status && error) *error = self->error;
    *steps = r.kind == DAL_RECORD_ROW ? r.number * (size_t)self->head.stride : 0;
    return status;
}

/* DAL_EINVAL unless the run is the one that the journal is of. */
static int compare(dal_journal *self, const dal_run *run, dal_error *error)
{
    const dal__head *const here = &self->head, run_head = head_of(run), *const there = &run_head;
    const struct { const char *name; uint64_t here, there; } numbers[] = {
        {"n", here->n, there->n}, {"m", here->m, there->m}, {"stride", here->stride, there->stride},
        {"the number of steps of a row of inputs", here->input_steps, there->input_steps},
        {"the number of inputs", here->inputs, there->inputs},
        {"the number of events", here->events, there->events},
        {"the storage of rows (0 or 1)", here->has_rows, there->has_rows},
        {"the use of times (0 or 1)", here->has_times, there->has_times},
        {"the size of a snapshot", here->snapshot, there->snapshot}};
    for (size_t i = 0; i < DAL_LENGTH(numbers); i++)
        if (numbers[i].here != numbers[i].there)
            return dal__fail(error, DAL_EINVAL, "%s: %s is %llu in the journal, but %llu in the "
                             "run", self->path, numbers[i].name,
                             (unsigned long long)numbers[i].here,
                             (unsigned long long)numbers[i].there);
    if (here->input_duration != there->input_duration)
        return dal__fail(error, DAL_EINVAL, "%s: a row of inputs applies for a time of %.17g in "
                         "the journal, but of %.17g in the run", self->path, here->input_duration,
                         there->input_duration);
    size_t steps;
    const int status = last_row(self, &steps, error);
    if (status) return status;
    if (steps < self->mark.done) steps = (size_t)self->mark.done;
    if (run->steps / run->stride + 1 < self->mark.stored || run->steps < steps)
        return dal__fail(error, DAL_EINVAL, "%s: contains %zu steps, but the run has only steps = "
                         "%zu", self->path, steps, run->steps);
    return DAL_SUCCESS;
}

/* Rows of inputs of the journal, into the run, or compared with those that stand there. */
static int give_inputs(const dal_journal *self, const dal_run *run, size_t first, size_t count,
                       const double *from, dal_error *error)
{
    const size_t width = (size_t)self->head.inputs;
    double *const to = width > 0 ? run->inputs + first * width : NULL;
    if (!to) return DAL_SUCCESS;
    if (run->control) memcpy(to, from, count * width * sizeof *to);
    for (size_t k = 0; k < count * width; k++)
        if (to[k] != from[k])
            return dal__fail(error, DAL_EINVAL, "%s: inputs[%zu] of row %zu is %.17g in the "
                             "journal, but %.17g in the run", self->path, k % width,
                             first + k / width, from[k], to[k]);
    return DAL_SUCCESS;
}

/* Up to a time of a run with error-controlled steps, the rows of inputs that were set. */
static void count_inputs(dal_run *run, double t)
{
    const double direction = run->input_duration > 0.0 ? 1.0 : -1.0;
    while (direction * (t - dal__run_begin_of_inputs(run, run->rows_set)) > 0.0) run->rows_set++;
}

static int give_row(const dal_journal *self, dal_run *run, const dal_record *r, dal_error *error)
{
    const size_t N = 2 * run->stepper->mech.n, m = run->stepper->mech.m;
    size_t first, count;
    const size_t steps = r->kind == DAL_RECORD_END ? (size_t)self->mark.done + 1
                                                   : r->number * run->stride;
    if (r->kind == DAL_RECORD_END) {
        run->ended = 1;
        run->t_end = r->t;
    }
    if (!self->head.has_rows) return DAL_SUCCESS;
    if (r->number != run->stored || run->stored == self->mark.stored)
        return dal__fail(error, DAL_EIO, "%s: damaged, row %zu in place of row %zu", self->path,
                         r->number, run->stored);
    if (run->x) memcpy(run->x + r->number * N, r->x, N * sizeof *r->x);
    if (run->row_times) run->row_times[r->number] = r->t;
    if (r->number == 0) run->t_begin = r->t;
    if (dal__run_varies(run) && run->inputs) count_inputs(run, r->t);
    if (run->reactions && r->number > 0)
        memcpy(run->reactions + (r->number - 1) * m, r->reaction, m * sizeof *r->reaction);
    pending_inputs(run, steps, &first, &count);
    const int status = give_inputs(self, run, first, count, r->input, error);
    run->stored++;
    run->rows_set_before = run->rows_set;
    return status;
}

/* What the journal has of the run before its last snapshot. */
static int give(dal_journal *self, dal_run *run, dal_error *error)
{
    const size_t N = 2 * run->stepper->mech.n;
    int status = DAL_SUCCESS;
    double *const event = run->stepper->fresh; /* its state, while the one after it is read */
    for (size_t i = 0; !status && i < self->mark.records; i++) {
        dal_record r = {0};
        status = read_record(self, i, &r);
        if (status && error) *error = self->error;
        if (status) return status;
        switch ((dal_record_kind)r.kind) {
        case DAL_RECORD_ROW:
        case DAL_RECORD_END: status = give_row(self, run, &r, error); break;
        case DAL_RECORD_TIME:
            if (r.number >= run->time_count || r.t != run->times[r.number])
                return dal__fail(error, DAL_EINVAL, "%s: times[%zu] is %.17g in the journal, but "
                                 "different in the run", self->path, r.number, r.t);
            memcpy(run->x_at_times + r.number * N, r.x, N * sizeof *r.x);
            break;
        case DAL_RECORD_RESET: memcpy(event, r.x, N * sizeof *event); break;
        case DAL_RECORD_EVENT:
        case DAL_RECORD_AFTER:
            if (run->happened)
                run->happened(r.number, r.step, r.t, r.kind == DAL_RECORD_EVENT ? r.x : event,
                              r.kind == DAL_RECORD_EVENT ? NULL : r.x, run->happened_ctx);
        }
    }
    return status;
}

/* The stepper, the events and the counters as the snapshot has them. */
static int restore(const dal_journal *self, dal_run *run, dal_error *error)
{
    dal_stepper *const stepper = run->stepper;
    dal_events *const e = run->events;
    dal__archive a = {.mode = DAL__RESTORE, .from = self->snapshot,
                      .at = dal_stepper_saved(stepper)};
    int status = dal_stepper_restore(stepper, a.from, a.at);
    dal__fail_because(error, status, &stepper->error, "%s, whose scheme is \"%s\": ", self->path,
                      self->head.scheme);
    if (!status && e) {
        status = dal_events_restore(e, a.from + a.at, dal_events_saved(e), error);
        a.at += dal_events_saved(e);
    }
    if (status) return status;
    dal__estimate_forget(stepper); /* the estimate of an earlier run */
    keep(run, &a);
    run->done = (size_t)self->mark.done;
    run->stored = (size_t)self->mark.stored;
    run->times_done = (size_t)self->mark.times_done;
    status = dal__run_check(run);
    if (status && error) *error = stepper->error;
    if (status) return status;
    size_t first, count;
    if (inputs_of(run) == 0 || run->ended) return DAL_SUCCESS;
    pending_inputs(run, run->done, &first, &count);
    return give_inputs(self, run, first, count, a.from + a.at, error);
}

int dal_journal_resume(dal_journal *journal, dal_run *run, dal_error *error)
{
    int status =
        DAL__REQUIRE(error, {"journal", journal}, {"run", run},
                     {"run->stepper", run && run->stepper});
    if (status) return status;
    if (!journal->writes)
        return dal__fail(error, DAL_EINVAL, "the journal is open for reading only; open it with "
                         "writes = 1 to resume the run");
    if (run->journal || run->done > 0 || run->stored > 0)
        return dal__fail(error, DAL_EINVAL, "the run has already begun, or has a journal: expected "
                         "a new run");
    status = dal__journal_recall(journal);
    if (status && error) *error = journal->error;
    if (!status) status = compare(journal, run, error);
    if (!status) status = give(journal, run, error);
    if (!status) status = restore(journal, run, error);
    if (!status && dal__journal_cut(journal)) {
        if (error) *error = journal->error;
        status = journal->error.status;
    }
    if (status) {
        run->done = run->stored = run->times_done = run->rows_set = run->rows_set_before = 0;
        run->ended = 0;
        return status;
    }
    journal->expected = journal->records;
    journal->records = journal->written = (size_t)journal->mark.records;
    journal->saved_at = dal__clock();
    run->journal = journal;
    return DAL_SUCCESS;
}
