/* journal.h - the file of a journal, and what a run writes there.
 *
 * The file: head, description, writer, three slots for snapshots, records.  The first slot keeps
 * that of the beginning; the others are written in turn, so that one of them is always whole.  The
 * checksum of a slot or a record is that of its bytes after the checksum, begun with the checksum
 * of the head and where in the file it stands: a part of another file, or from elsewhere, is none
 * of it. */
#ifndef DAL__JOURNAL_H
#define DAL__JOURNAL_H

#include "dalembert/journal.h"
#include "ground/ground.h"

enum { DAL__SLOTS = 3, DAL__WRITER = 128 };

/* As it stands in the file. */
typedef struct dal__head {
    char magic[8];
    uint32_t order, version; /* of bytes; of this format */
    uint32_t checksum;       /* of head and description, with 0 here */
    uint32_t has_rows, has_times;
    uint32_t reserved;
    uint64_t n, m, inputs, stride, input_steps, input_rows, events;
    uint64_t description_size;
    uint64_t snapshot;       /* doubles of a snapshot */
    double t0, h, input_duration, made; /* made: when, so that no two are alike */
    char scheme[40];
    unsigned char fingerprint[32];
} dal__head;

/* In front of the doubles of a snapshot. */
typedef struct dal__mark {
    uint32_t checksum, serial; /* serial: counts the snapshots */
    uint64_t steps, done, stored, times_done; /* of the run */
    uint64_t records;          /* before it */
} dal__mark;

/* In front of the doubles of a record. */
typedef struct dal__tag {
    uint32_t checksum, kind;
    uint64_t number, step;
} dal__tag;

struct dal_journal {
    dal__head head;
    int file;
    bool writes;
    bool goes_on;
    double seconds, saved_at;
    size_t description_at, writer_at, slots_at, slot_size, begin, size; /* of what, in bytes */
    size_t records;          /* in the file, or to be */
    size_t written;          /* of them are in the file */
    size_t expected;         /* records that the file has; the run is to make them again */
    size_t unseen;           /* steps since the time was looked at */
    bool failed;             /* the last call of dal_run_go */
    size_t cut;
    bool is_written;         /* by another process, when it was opened to be read */
    dal__mark mark;          /* of the last snapshot, and its numbers */
    double *snapshot;        /* [head.snapshot] */
    double *reaction;        /* [m] where the run has no place for it */
    unsigned char *slot;     /* [slot_size] */
    unsigned char *line;     /* [size] the record that is being made */
    unsigned char *block;    /* [capacity*size] records to be written, or those that were read: */
    size_t capacity, read_at, read_count;
    uint32_t table[8][256];
    char *path, *description, *writer;
    dal_error error;
    arena arena;
};

/* ---- the file (journal_file.c).  DAL_EIO with the path and the system's words. */

/* A journal in memory, for a head, or for what the file has. */
int dal__journal_allocate(dal_journal **journal, const char *path, const dal__head *head,
                          const void *description, dal_error *error);
/* The file of a new journal, under its name, locked; the first snapshot is in journal->snapshot. */
int dal__journal_create(dal_journal *self, dal_error *error);
/* The file, locked if it writes; its records are counted, and what follows them is cut. */
int dal__journal_attach(dal_journal **journal, const char *path, bool writes, dal_error *error);
void dal__journal_detach(dal_journal *self);

/* The file without what follows its last good record. */
int dal__journal_cut(dal_journal *self);

/* The record of a number, in memory; NULL and self->error if it cannot be read. */
const unsigned char *dal__journal_record(dal_journal *self, size_t index);
/* Place for the next record of a kind, whose doubles are 0. */
double *dal__journal_next(dal_journal *self, dal_record_kind kind, size_t number, size_t step);
/* It is complete: one more that is to be written, or compared with what the file has. */
int dal__journal_add(dal_journal *self);
/* Those that are not written yet. */
int dal__journal_flush(dal_journal *self);
/* self->mark and self->snapshot, after all records, to the disk. */
int dal__journal_save(dal_journal *self);
/* self->mark and self->snapshot <- the last snapshot whose records are all there;
 * DAL_EUNSUPPORTED if there is none. */
int dal__journal_recall(dal_journal *self);

#endif /* DAL__JOURNAL_H */
