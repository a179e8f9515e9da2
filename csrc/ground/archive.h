/* archive.h - the numbers that an object saves: one list of them, by which they are counted, saved,
 * checked and restored. */
#ifndef DAL__ARCHIVE_H
#define DAL__ARCHIVE_H

#include "ground/ground.h"

typedef enum dal__archive_mode {
    DAL__COUNT, DAL__SAVE, DAL__CHECK, DAL__RESTORE
} dal__archive_mode;

typedef struct dal__archive {
    dal__archive_mode mode;
    double *to;           /* DAL__SAVE */
    const double *from;   /* DAL__CHECK, DAL__RESTORE */
    size_t at;            /* how many numbers so far */
    /* DAL__CHECK: the first number that is wrong, and how: NULL if none is.  With a name it is not
     * the one that it has to be. */
    const char *wrong, *name;
    size_t where;
    double expected;
    double h;             /* that of the motion */
} dal__archive;

/* The next number of the archive.  It has to be finite; positive; not negative; of the sign of h;
 * any but NaN; a whole number that a double holds; 0 or 1; this very number. */
void dal__archive_real(dal__archive *a, double *x);
void dal__archive_positive(dal__archive *a, double *x);
void dal__archive_size(dal__archive *a, double *x);
void dal__archive_ahead(dal__archive *a, double *x);
void dal__archive_any(dal__archive *a, double *x);
void dal__archive_counter(dal__archive *a, size_t *x);
void dal__archive_flag(dal__archive *a, bool *x);
void dal__archive_same(dal__archive *a, const char *name, double x);
/* The next numbers, all finite. */
void dal__archive_vector(dal__archive *a, size_t count, double *x);

#endif /* DAL__ARCHIVE_H */
