/* dalembert/journal.h - runs that survive the death of their process.
 *
 * A journal is a file beside a run: it gets all that the run stores (rows, reactions, inputs,
 * events, states at output times) as records of fixed size with a checksum, and every few seconds
 * a snapshot of the stepper and its events.  Whatever ends the process, the file has
 *   1. every record that was acknowledged, which is: dal_run_go has returned;
 *   2. no damaged record: what follows the last good one is cut off, and info says how much;
 *   3. a run to go on with: its records are bit for bit those of the run that was never stopped, on
 *      the same kind of machine; those after the last snapshot are computed again and compared;
 *   4. after a loss of power what was there at the last snapshot, on a disk of its own machine;
 *   5. one writer at a time, where the file system has locks, and readers whenever they like.
 * Nothing in it is executed.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_JOURNAL_H
#define DALEMBERT_JOURNAL_H

#include <dalembert.h>

#ifdef __cplusplus
extern "C" {
#endif

/* <cdef> */
/* ---- journals -------------------------------------------------------------------------- */

typedef struct dal_journal dal_journal;

/* Zero-initialised: the defaults. */
typedef struct dal_journal_options {
    double seconds;           /* from snapshot to snapshot; 0: 5; < 0: when records are written */
    int goes_on;              /* what a run does when the file cannot be written.  0: it ends with
                                 DAL_EIO; 1: it goes on without, see dal_journal_error */
    const void *description;  /* [description_size] bytes that say what the system is, or NULL */
    size_t description_size;
    unsigned char fingerprint[32]; /* of the system, for whoever opens the file */
} dal_journal_options;

typedef enum dal_record_kind {
    DAL_RECORD_ROW = 1,   /* row `number` of the run: t, x, the mean reaction since the row before,
                             and the inputs whose steps began since then */
    DAL_RECORD_END = 2,   /* the same of the row at t_end, where a terminal event has ended the run,
                             also of one that stores no rows */
    DAL_RECORD_TIME = 3,  /* the state at times[number]: t, x */
    DAL_RECORD_EVENT = 4, /* event `number` of the list: t, x */
    DAL_RECORD_RESET = 5, /* the same of one whose reset led elsewhere */
    DAL_RECORD_AFTER = 6  /* the state after that reset: the record that follows */
} dal_record_kind;

/* Of `size` bytes in the file: a checksum and the kind, of 4 bytes each; number and step, of 8; t;
 * x[2n]; reaction[m]; input[holds*inputs].  What a kind does not have is 0. */
typedef struct dal_record {
    int kind;
    size_t number, step;   /* step: as an observer or happened is told */
    double t;
    const double *x, *reaction, *input;
} dal_record;

/* What a journal is of.  Pointers are borrowed. */
typedef struct dal_journal_info {
    size_t n, m, inputs;       /* inputs: 0 if the run was given none */
    size_t stride, hold;
    size_t holds;              /* the most rows of inputs that begin in an interval of the run; as
                                  many as its steps of error-controlled ones */
    size_t events;             /* how many there are in the list */
    int has_rows, has_times;   /* which of them there are: rows also for their inputs */
    double t0, h;              /* of the run's first row, which may be a later step of a stepper;
                                  h: 0 of error-controlled steps */
    const char *scheme;        /* its name */
    const char *description;
    size_t description_size;
    const unsigned char *fingerprint; /* [32] */
    size_t steps, done;        /* of the run, as the last snapshot knows them */
    size_t records, size;      /* how many good ones the file has, and the bytes of each */
    size_t begin;              /* where in the file the first begins */
    size_t cut;                /* bytes behind the last good one: being written, or damaged */
    const char *writer;        /* "process P on HOST" that has opened it for writing last */
    int is_written;            /* 1: and that had it open when this was opened */
} dal_journal_info;

/* *journal <- a new file at path, for a run that is set up and has not begun: what dal_run_go makes
 * of it then goes there too.  scheme is the record that the stepper was made of.  The file appears
 * under its name when it is complete, with a snapshot of the beginning.
 * DAL_EINVAL (the file is there already; the run has begun, or is not valid), DAL_EUNSUPPORTED (the
 * steps of the scheme cannot be resumed), DAL_EIO, DAL_ENOMEM. */
DAL_API int dal_journal_new(dal_journal **journal, const char *path, dal_run *run,
                            const dal_scheme *scheme, const dal_journal_options *options,
                            dal_error *error);

/* *journal <- the journal at path; writes: 1 to go on with it, 0 to read.  Every record is looked
 * at.  Of options, which may be NULL, `seconds` and `goes_on` are used.
 * DAL_EINVAL (no journal, one of another version or byte order, or its head is damaged; another
 * process writes it: the text says which), DAL_EIO, DAL_ENOMEM. */
DAL_API int dal_journal_open(dal_journal **journal, const char *path, int writes,
                             const dal_journal_options *options, dal_error *error);

/* A snapshot now, between two calls of dal_run_go; success where the run has no journal.
 * DAL_EINVAL (not started), DAL_EIO. */
DAL_API int dal_journal_save(dal_run *run);

/* Writes what is left.  NULL is allowed. */
DAL_API void dal_journal_free(dal_journal *journal);

/* *info <- what the journal is of. */
DAL_API void dal_journal_describe(const dal_journal *journal, dal_journal_info *info);

/* Why the file is no longer written; status 0 if it is. */
DAL_API const dal_error *dal_journal_error(const dal_journal *journal);

/* *record <- the record of this number, counted from 0; its arrays are valid until the next call.
 * DAL_EINVAL (there is none), DAL_EIO. */
DAL_API int dal_journal_read(dal_journal *journal, size_t index, dal_record *record,
                             dal_error *error);

/* run, set up as that of the journal with a new stepper and new events, <- where the last snapshot
 * left it: rows, reactions, inputs and states at times are filled in, happened is told of the
 * events, and dal_run_go goes on, into the journal.  The number of steps may be another one than
 * that of the journal.
 * Inputs that stand in the run, of one without control, have to be those of the journal.
 * DAL_EINVAL (what in the run is not as in the journal), DAL_EIO, DAL_EUNSUPPORTED (the file is so
 * damaged that no snapshot is left). */
DAL_API int dal_journal_resume(dal_journal *journal, dal_run *run, dal_error *error);

/* </cdef> */

#ifdef __cplusplus
}
#endif
#endif /* DALEMBERT_JOURNAL_H */
