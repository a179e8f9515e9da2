/* Numbers that are counted, saved, checked or restored. */
#include "ground/archive.h"

#include <math.h>

/* Each returns why a number is refused, or NULL. */
static const char *finite(double x) { return isfinite(x) ? NULL : "not finite"; }

static const char *any(double x) { return isnan(x) ? "not a number" : NULL; }

static const char *positive(double x) { return x > 0.0 ? finite(x) : "not positive"; }

static const char *size(double x) { return x >= 0.0 ? finite(x) : "negative"; }

static const char *whole(double x)
{
    return x >= 0.0 && x <= 0x1p53 && x == floor(x) ? NULL
         : isfinite(x) ? "not a whole number from 0 to 2^53" : "not finite";
}

static const char *flag(double x)
{
    return x == 0.0 || x == 1.0 ? NULL : isfinite(x) ? "neither 0 nor 1" : "not finite";
}

/* Whether *x is restored. */
static bool pass(dal__archive *a, double *x, const char *(*fault)(double))
{
    const size_t at = a->at++;
    switch (a->mode) {
    case DAL__COUNT: break;
    case DAL__SAVE: a->to[at] = *x; break;
    case DAL__CHECK:
        if (a->wrong) break;
        a->wrong = fault(a->from[at]);
        a->where = at;
        break;
    case DAL__RESTORE: *x = a->from[at]; return true;
    }
    return false;
}

void dal__archive_real(dal__archive *a, double *x) { pass(a, x, finite); }

void dal__archive_positive(dal__archive *a, double *x) { pass(a, x, positive); }

void dal__archive_size(dal__archive *a, double *x) { pass(a, x, size); }

void dal__archive_ahead(dal__archive *a, double *x)
{
    const bool checked = a->mode == DAL__CHECK && !a->wrong;
    pass(a, x, finite);
    if (checked && !a->wrong && !(a->h * a->from[a->where] > 0.0))
        a->wrong = "not of the sign of h";
}

void dal__archive_any(dal__archive *a, double *x) { pass(a, x, any); }

void dal__archive_counter(dal__archive *a, size_t *x)
{
    double value = (double)*x;
    if (pass(a, &value, whole)) *x = (size_t)value;
}

void dal__archive_flag(dal__archive *a, bool *x)
{
    double value = *x;
    if (pass(a, &value, flag)) *x = value != 0.0;
}

void dal__archive_same(dal__archive *a, const char *name, double x)
{
    const bool right = a->wrong || a->mode != DAL__CHECK || a->from[a->at] == x;
    double value = x;
    pass(a, &value, any);
    if (right) return;
    a->wrong = "not that of this stepper";
    a->name = name;
    a->expected = x;
}

void dal__archive_vector(dal__archive *a, size_t count, double *x)
{
    for (size_t i = 0; i < count; i++) dal__archive_real(a, x + i);
}
