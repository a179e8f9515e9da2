/* dalembert/journal.h - files from which interrupted runs resume.
 *
 * A journal is a file beside a run.  It receives all results that the run stores (rows, reactions,
 * inputs, events, states at output times) as records of fixed size with a checksum.  Every few
 * seconds it receives a snapshot of the stepper and its events.  After any end of the process, the
 * file has the following properties.
 *   1. It has every record that was acknowledged, which means that dal_run_go has returned.
 *   2. It has no damaged record: bytes after the last valid one are cut off, and info has their
 *      number.
 *   3. The run can be resumed from it.  On the same kind of machine its records are bitwise those
 *      of an uninterrupted run; those after the last snapshot are computed again and compared.
 *   4. After a loss of power it has all data up to the last snapshot, on a local disk.
 *   5. It has one writer at a time, if the file system has locks, and any number of readers.
 * Reading a journal executes nothing.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_JOURNAL_H
#define DALEMBERT_JOURNAL_H

#include <dalembert/run.h>

DAL_BEGIN_DECLARATIONS

/* <cdef> */
/* ---- journals -------------------------------------------------------------------------- */

typedef struct dal_journal dal_journal;

/* Options of a journal; a zero-initialised record has the defaults. */
typedef struct dal_journal_options {
    double seconds;           /* time between snapshots; 0: 5; < 0: a snapshot whenever records are
                                 written */
    int goes_on;              /* if the file cannot be written, the run ends with DAL_EIO (0) or
                                 continues without it (1), see dal_journal_error */
    const void *description;  /* [description_size] bytes that describe the system, or NULL */
    size_t description_size;
    unsigned char fingerprint[32]; /* identifies the system for readers of the file */
} dal_journal_options;

typedef enum dal_record_kind {
    DAL_RECORD_ROW = 1,   /* row `number` of the run: t, x, the mean reaction since the previous
                             row, and the inputs whose steps began since then */
    DAL_RECORD_END = 2,   /* the same for the row at t_end of a terminal event, also in a run that
                             stores no rows */
    DAL_RECORD_TIME = 3,  /* the state at times[number]: t, x */
    DAL_RECORD_EVENT = 4, /* event `number` of the list: t, x */
    DAL_RECORD_RESET = 5, /* the same for an event whose reset changed the state */
    DAL_RECORD_AFTER = 6  /* the state after this reset, in the next record */
} dal_record_kind;

/* A record has `size` bytes in the file: a checksum and the kind, 4 bytes each; number and step, 8
 * bytes each; t; x[2n]; reaction[m]; input[input_rows*inputs].  Parts that a kind does not have
 * are 0.
 */
typedef struct dal_record {
    int kind;
    size_t number, step;   /* step as for an observer or happened */
    double t;
    const double *x, *reaction, *input;
} dal_record;

/* The data of a journal.  Pointers are borrowed. */
typedef struct dal_journal_info {
    size_t n, m, inputs;       /* inputs: 0 if the run has none */
    size_t stride, input_steps;
    size_t input_rows;         /* the largest number of rows of inputs that begin in an interval of
                                  the run; for variable steps the number of its steps */
    size_t events;             /* number of events in the list */
    int has_rows, has_times;   /* whether the run stores rows (also for their inputs), and states at
                                  output times */
    double t0, h;              /* time of the run's first row, which may be a later step of a
                                  stepper; step size, 0 for variable steps */
    const char *scheme;        /* its name */
    const char *description;
    size_t description_size;
    const unsigned char *fingerprint; /* [32] */
    size_t steps, done;        /* number of steps of the run, and steps taken at the last
                                  snapshot */
    size_t records, size;      /* number of valid records in the file, and bytes of each */
    size_t begin;              /* offset of the first record in the file */
    size_t cut;                /* bytes after the last valid record: being written, or damaged */
    const char *writer;        /* "process P on HOST" that last opened it for writing */
    int is_written;            /* 1: this process had it open when the journal was opened here */
} dal_journal_info;

/* Creates a journal: *journal <- a new file at path, for a run that is set up and has not begun.
 * The results of dal_run_go are then also written to it.  The argument scheme is that of the
 * stepper.  The file appears under its name when it is complete, with a snapshot of the beginning.
 * Errors: DAL_EINVAL (the file exists; the run has begun or is invalid); DAL_EUNSUPPORTED (the
 * steps of the scheme cannot be resumed); DAL_EIO; DAL_ENOMEM. */
DAL_API int dal_journal_new(dal_journal **journal, const char *path, dal_run *run,
                            const dal_scheme *scheme, const dal_journal_options *options,
                            dal_error *error);

/* Opens a journal: *journal <- the journal at path; writes is 1 to continue it, 0 to read it.
 * Every record is checked.  The options `seconds` and `goes_on` are used; options may be NULL.
 * Errors: DAL_EINVAL (not a journal; another version or byte order; a damaged head; another process
 * is writing it; the text says which); DAL_EIO; DAL_ENOMEM. */
DAL_API int dal_journal_open(dal_journal **journal, const char *path, int writes,
                             const dal_journal_options *options, dal_error *error);

/* Writes a snapshot, between two calls of dal_run_go.  Does nothing if the run has no journal.
 * Errors: DAL_EINVAL (not started); DAL_EIO. */
DAL_API int dal_journal_save(dal_run *run);

/* Writes pending records and closes the journal.  NULL is allowed. */
DAL_API void dal_journal_free(dal_journal *journal);

/* Describes the journal: *info <- its data. */
DAL_API void dal_journal_describe(const dal_journal *journal, dal_journal_info *info);

/* Returns the reason why the file is no longer written; status 0 if it is. */
DAL_API const dal_error *dal_journal_error(const dal_journal *journal);

/* Reads *record <- the record of this number, counted from 0.  Its arrays are valid until the next
 * call.
 * Errors: DAL_EINVAL (no such record); DAL_EIO. */
DAL_API int dal_journal_read(dal_journal *journal, size_t index, dal_record *record,
                             dal_error *error);

/* Restores a run to the last snapshot.  The run must be set up like that of the journal, with a new
 * stepper and new events.  Rows, reactions, inputs and states at output times are filled in, and
 * happened is called for the events.  Then dal_run_go continues the run and its journal.  The
 * number of steps may differ from that of the journal.  Inputs given for a run without control have
 * to be those of the journal.
 * Errors: DAL_EINVAL (the run differs from the journal, and the text names the difference);
 * DAL_EIO;
 * DAL_EUNSUPPORTED (no snapshot in the file is intact). */
DAL_API int dal_journal_resume(dal_journal *journal, dal_run *run, dal_error *error);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_JOURNAL_H */
