/* Dense output: the state at all times of a motion. */
#include "dalembert/taylor.h"
#include "step/polynomials.h"
#include "step/taylor.h"

#include <string.h>

struct dal_taylor_dense {
    dal__polynomials pieces;
    dal_stepper *stepper; /* of the system and scheme, whose workspace is used */
    arena arena;
};

int dal_taylor_dense_new(dal_taylor_dense **dense, const dal_system *system,
                         const dal_scheme *scheme, dal_error *error)
{
    int status = DAL__REQUIRE(error, {"dense", dense}, {"system", system}, {"scheme", scheme});
    if (status) return status;
    dal_taylor_dense *self;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    status = dal__allocate(&memory, error);
    if (status) return status;
    self->arena = memory;
    status = dal_stepper_new(&self->stepper, system, scheme, NULL, error);
    if (!status && !dal__taylor_has_pieces(self->stepper))
        status = dal__fail(error, DAL_EUNSUPPORTED, "scheme \"%s\" has no polynomials; choose the "
                           "scheme taylor", scheme->name);
    if (status) {
        dal_taylor_dense_free(self);
        return status;
    }
    self->pieces.inputs = self->stepper->motion.system->def.inputs;
    *dense = self;
    return DAL_SUCCESS;
}

void dal_taylor_dense_free(dal_taylor_dense *dense)
{
    if (!dense) return;
    dal_stepper_free(dense->stepper);
    dal__release(&dense->pieces.memory);
    dal__release(&dense->arena);
}

/* Whether two steppers have the same scheme, and systems with the same parameters. */
static bool are_alike(const dal_stepper *one, const dal_stepper *other)
{
    const dal_system_def *const a = &one->motion.system->def, *const b = &other->motion.system->def;
    return one->identity == other->identity && a->series == b->series
        && a->ctx_size == b->ctx_size
        && (a->ctx_size == 0 ? a->ctx == b->ctx : memcmp(a->ctx, b->ctx, a->ctx_size) == 0);
}

int dal_taylor_keep(dal_stepper *stepper, dal_taylor_dense *dense)
{
    if (!stepper) return DAL_EINVAL;
    if (dense && !are_alike(dense->stepper, stepper))
        return dal__fail(&stepper->error, DAL_EINVAL, "dense belongs to another system or scheme");
    if (dense) dense->pieces.count = 0;
    stepper->motion.kept = dense ? &dense->pieces : NULL;
    return DAL_SUCCESS;
}

size_t dal_taylor_dense_count(const dal_taylor_dense *dense, size_t *bytes)
{
    const dal__polynomials *const pieces = &dense->pieces;
    if (bytes) *bytes = pieces->room * pieces->numbers * sizeof(double);
    return pieces->count;
}

int dal_taylor_dense_states(dal_taylor_dense *dense, size_t count, const double *t, double *x)
{
    if (!dense) return DAL_EINVAL;
    dal_stepper *const stepper = dense->stepper;
    const size_t N = 2 * stepper->mech.n;
    int status = DAL_SUCCESS;
    for (size_t k = 0; !status && k < count; k++) {
        dal__piece piece;
        if (!dal__polynomials_find(&dense->pieces, t[k], &piece))
            return dal__fail(&stepper->error, DAL_EINVAL, "t[%zu] = %.17g is outside the motion",
                             k, t[k]);
        piece.parameters = stepper->motion.system->def.ctx;
        status = dal__taylor_state(stepper, &piece, t[k], x + k * N);
    }
    return status;
}

const dal_error *dal_taylor_dense_error(const dal_taylor_dense *dense)
{
    return &dense->stepper->error;
}
