/* scheme.h - records of schemes, and the list of their families. */
#ifndef DAL__SCHEME_H
#define DAL__SCHEME_H

#include "dalembert/family.h"
#include "dalembert/inspect.h"

/* Those that the build list names, the one of records without a family first; NULL at the end. */
extern const dal_family *const dal__families[];
const dal_family *dal__scheme_family(const dal_scheme *scheme);

/* The decimal number at the start of text, *end behind it; NaN if there is none.  strtod would want
 * the decimal point of the host's locale. */
double dal__parse_number(const char *text, const char **end);

/* The sub-steps of a record: its own, or the only one {beta, 1}. */
size_t dal__scheme_count(const dal_scheme *scheme);
dal_substep dal__scheme_substep(const dal_scheme *scheme, size_t j);
/* DAL_EINVAL unless the record has what all families know: moved nodes, no sub-steps. */
int dal__scheme_check_plain(const dal_scheme *scheme, const char *family, dal_error *error);
/* A number of system and scheme, but for callbacks and what is behind data. */
double dal__scheme_identify(const dal_system *system, const dal_scheme *scheme);
/* A number of a text. */
double dal__digest_text(const char *text);

#endif /* DAL__SCHEME_H */
