/* Status codes in words, the error record, and watches. */
#include "ground/ground.h"
#include "version.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

const char *dal_version(void) { return DAL_VERSION; }

const char *dal_strerror(int status)
{
    switch ((dal_status)status) {
    case DAL_SUCCESS: return "success";
    case DAL_STOPPED: return "stopped by an observer or a watch";
    case DAL_EINVAL: return "invalid argument";
    case DAL_ENOMEM: return "out of memory";
    case DAL_EUSER: return "a callback failed";
    case DAL_EDOMAIN: return "a callback is undefined or not finite here";
    case DAL_ESINGULAR: return "a matrix is singular to working precision";
    case DAL_ENOCONV: return "an iteration did not converge";
    case DAL_EOFFD: return "initial data do not satisfy the constraint";
    case DAL_EUNSUPPORTED: return "not supported";
    case DAL_EIO: return "a file cannot be read or written";
    case DAL_EZENO: return "too many events in one step";
    }
    return "unknown status";
}

/* The text from its character `at` on. */
static void write(dal_error *error, size_t at, const char *format, va_list arguments)
{
    vsnprintf(error->text + at, sizeof error->text - at, format, arguments);
}

int dal__fail(dal_error *error, int status, const char *format, ...)
{
    if (!error) return status;
    va_list arguments;
    va_start(arguments, format);
    *error = (dal_error){.status = status};
    write(error, 0, format, arguments);
    va_end(arguments);
    return status;
}

void dal__add_words(dal_error *error, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    write(error, strlen(error->text), format, arguments);
    va_end(arguments);
}

int dal__fail_entry(dal_error *error, int status, const dal__entry *entry, const char *format, ...)
{
    if (!error) return status;
    va_list arguments;
    va_start(arguments, format);
    dal__fail(error, status, "%s%s%s[%zu,%zu]", entry->callback ? entry->callback : "",
              entry->callback ? ": " : "", entry->output, entry->row, entry->column);
    error->output = entry->output;
    error->row = entry->row;
    error->column = entry->column;
    error->value = entry->value;
    error->end = strlen(error->text);
    write(error, error->end, format, arguments);
    va_end(arguments);
    return status;
}

int dal__fail_because(dal_error *error, int status, const dal_error *cause, const char *format, ...)
{
    if (!error || status == DAL_SUCCESS) return status;
    const dal_error inner = *cause;
    va_list arguments;
    va_start(arguments, format);
    *error = inner;
    error->status = status;
    write(error, 0, format, arguments);
    va_end(arguments);
    const size_t before = strlen(error->text);
    snprintf(error->text + before, sizeof error->text - before, "%s", inner.text);
    if (error->output) {
        error->begin += before;
        error->end += before;
    }
    return status;
}

int dal__require_arguments(dal_error *error, size_t count, const dal__argument *arguments)
{
    for (size_t i = 0; i < count; i++)
        if (!arguments[i].given)
            return dal__fail(error, DAL_EINVAL, "%s is NULL", arguments[i].name);
    return dal__fail(error, DAL_SUCCESS, "%s", "");
}

int dal__require_numbers(dal_error *error, size_t count, const dal__numbers *arguments)
{
    for (const dal__numbers *a = arguments; a < arguments + count; a++) {
        if (!a->x) return dal__fail(error, DAL_EINVAL, "%s is NULL", a->name);
        for (size_t i = 0; i < a->count; i++)
            if (!isfinite(a->x[i]))
                return dal__fail(error, DAL_EINVAL, "%s[%zu] = %g is not finite", a->name, i,
                                 a->x[i]);
    }
    return DAL_SUCCESS;
}

int dal__require_step(dal_error *error, double h)
{
    if (isfinite(h) && h != 0.0) return DAL_SUCCESS;
    return dal__fail(error, DAL_EINVAL, "h = %g: expected a finite step other than 0", h);
}

int dal__require_output(dal_error *error, const char *name, size_t count, const double *x)
{
    for (size_t i = 0; x && i < count; i++)
        if (!isfinite(x[i]))
            return dal__fail(error, DAL_EDOMAIN, "the result %s[%zu] = %g is not finite", name, i,
                             x[i]);
    return DAL_SUCCESS;
}

int dal__deliver(dal_error *error, size_t count, const dal__result *results)
{
    for (const dal__result *r = results; r < results + count; r++) {
        const int status = dal__require_output(error, r->name, r->count, r->to ? r->from : NULL);
        if (status) return status;
    }
    for (const dal__result *r = results; r < results + count; r++)
        if (r->to) memcpy(r->to, r->from, r->count * sizeof *r->to);
    return DAL_SUCCESS;
}

int dal__callback_status(int returned)
{
    if (returned == 0) return DAL_SUCCESS;
    return returned > 0 ? DAL_EDOMAIN : DAL_EUSER;
}

double dal__clock(void)
{
    struct timespec now;
    timespec_get(&now, TIME_UTC);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int dal__relay(double far, void *ctx)
{
    const dal__watch *const watch = ctx;
    (void)far;
    return watch->function ? watch->function(watch->made, watch->ctx) : 0;
}

int dal__ask(dal__watch *watch, double far, dal_error *error)
{
    if (!watch->function) return DAL_SUCCESS;
    const double now = dal__clock();
    if (fabs(now - watch->asked) < DAL_WATCH_SECONDS) return DAL_SUCCESS;
    watch->asked = now;
    const int returned = watch->function(far, watch->ctx);
    if (returned == 0) return DAL_SUCCESS;
    return dal__fail(error, returned > 0 ? DAL_STOPPED : DAL_EUSER,
                     "the watch function returned %d", returned);
}
