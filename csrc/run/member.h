/* member.h - the members of an ensemble, one by one (member.c), in lanes (batch.c), four by four
 * (side.c). */
#ifndef DAL__MEMBER_H
#define DAL__MEMBER_H

#include "dalembert/ensemble.h"
#include "run/run.h"
#include "step/lanes.h"

/* A member in a lane. */
typedef struct dal__lane {
    bool goes;
    size_t loaded;   /* steps made when it was loaded */
    size_t expected; /* and now, if it has not stopped */
    dal_run run;
} dal__lane;

typedef struct dal__sides dal__sides;

/* Runs the members of a range. */
typedef struct dal__worker {
    const dal_members *members;
    const dal_system *system; /* of the member: own, if there are parameters */
    dal_system *own;
    dal_stepper *stepper;
    dal_mechanics *mech;      /* for energy, residual, multipliers; NULL if none is wanted */
    dal_events *events;       /* or NULL */
    dal_law *laws;            /* [events] of their resets */
    dal_law control;
    double *inputs;           /* [input_rows*inputs] that the control has written */
    dal__lanes *lanes;        /* or NULL, and */
    size_t width;             /* how many there are */
    dal__lane *lane;          /* [width] */
    dal__sides *sides;        /* or NULL */
    size_t first, member;     /* of the range; the current one */
    size_t rows, reactions;   /* of each member */
    dal_run run;              /* of the member */
    size_t piece;             /* steps between two looks at the clock */
    dal__watch watch;
    int stopped;              /* DAL_STOPPED or DAL_EUSER: by the watch */
    arena arena;
} dal__worker;

/* Row `member` of what is given for all of them. */
#define ROW_OF(members, what, member) ((members)->what + (member) * (members)->what##_next)

/* A new run of the member at its start, without results.  DAL_STOPPED after a stop; the errors of
 * dal_stepper_start. */
int dal__member_open(dal__worker *self);
/* The remaining steps and the results of the member.  The status of the member. */
int dal__member_complete(dal__worker *self);
/* Stores the results at the end of a run.  The status of the member, given that of its run. */
int dal__member_finish(dal__worker *self, int status);
/* Stores the status of the member, and the error of the stepper if it has failed. */
void dal__member_report(const dal__worker *self, int status);
/* The system takes the parameters of the member. */
int dal__member_bind(dal__worker *self);
/* Asks the watch whether to stop, about 20 times a second.  done: the number of complete members of
 * the range; began: the clock before the last steps. */
void dal__worker_poll(dal__worker *self, double done, double began);

/* Runs so many members from the first on, in batches of as many as there are lanes. */
void dal__batches_run(dal__worker *self, size_t count);

/* *sides <- places for members of a worker; dal__taylor_has_four holds for its stepper. */
int dal__sides_new(dal__sides **sides, const dal__worker *worker, const dal_options *options,
                   dal_error *error);
void dal__sides_free(dal__sides *sides);
/* Runs so many members from the first on in these places. */
void dal__sides_run(dal__worker *self, size_t count);

#endif /* DAL__MEMBER_H */
