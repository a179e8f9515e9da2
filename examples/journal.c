/* A run that survives its process, because it keeps a journal.  The first process ends too early,
 * as if it had been killed; the second resumes the run, to the bits of an uninterrupted one.
 *
 *     cc journal.c $(pkg-config --cflags --libs dalembert) -o journal && ./journal */
#include <dalembert.h>
#include <dalembert/journal.h>
#include <stdio.h>

enum { STEPS = 1000000, STRIDE = 1000 };

static int fail(const char *text)
{
    fprintf(stderr, "%s\n", text);
    return 1;
}

/* In parts of so many steps; after each part the journal is written. */
static int go(dal_run *run, size_t parts)
{
    int status = DAL_SUCCESS;
    while (!status && run->done < run->steps && parts-- > 0) status = dal_run_go(run, 50000);
    return status;
}

int main(void)
{
    static double rows[STEPS / STRIDE + 1][6];
    dal_system *system;
    dal_scheme scheme;
    dal_error error;
    double x[6];
    if (dal_system_builtin(&system, "sleigh", NULL, NULL, 0, &error)
        || dal_scheme_find(&scheme, "leapfrog", &error)) return fail(error.text);
    dal_system_state(system, x);
    remove("sleigh.dal"); /* left by a previous run */

    for (int life = 0; life < 2; life++) { /* the first one ends too early */
        dal_stepper *stepper;
        dal_journal *journal;
        if (dal_stepper_new(&stepper, system, &scheme, NULL, &error)) return fail(error.text);
        dal_run run = {.stepper = stepper, .steps = STEPS, .stride = STRIDE, .x = rows[0]};
        if (dal_journal_open(&journal, "sleigh.dal", 1, NULL, NULL)) {
            if (dal_stepper_start(stepper, 0.0, 0.01, x, DAL_CHECK, DAL_INITIAL_NONE))
                return fail(dal_stepper_error(stepper)->text);
            if (dal_journal_new(&journal, "sleigh.dal", &run, &scheme, NULL, &error))
                return fail(error.text);
        } else if (dal_journal_resume(journal, &run, &error)) {
            return fail(error.text);
        }
        printf("life %d: from step %zu", life + 1, run.done);
        if (go(&run, life == 0 ? 7 : 100)) return fail(dal_stepper_error(stepper)->text);
        printf(" to step %zu, t = %g\n", run.done, dal_stepper_time(stepper));
        dal_journal_free(journal);
        dal_stepper_free(stepper);
    }
    printf("x = %.15g, y = %.15g\n", rows[STEPS / STRIDE][0], rows[STEPS / STRIDE][1]);
    dal_system_free(system);
    return remove("sleigh.dal");
}
