/* Where polynomials change their sign: of known zeros, simple, double, close together and at the
 * ends. */
#include "algebra/algebra.h"
#include "check.h"

#include <math.h>

/* c[count + 1] <- the coefficients of the product of (s - zero), times a factor. */
static void multiply(size_t count, const double *zeros, double factor, double *c)
{
    c[0] = factor;
    for (size_t k = 0; k < count; k++) {
        c[k + 1] = c[k];
        for (size_t j = k; j > 0; j--) c[j] = c[j - 1] - zeros[k] * c[j];
        c[0] *= -zeros[k];
    }
}

static dal__sign_changes changes_of(size_t count, const double *zeros, double factor)
{
    double c[DAL_ROOTS_MOST + 1];
    dal__sign_changes found;
    multiply(count, zeros, factor, c);
    dal__find_sign_changes(count, c, 0.0, &found);
    return found;
}

static void test_simple_zeros(void)
{
    const double zeros[] = {0.1, 0.30001, 0.3, 0.999, 0.5, -0.2, 1.7};
    const double inside[] = {0.1, 0.3, 0.30001, 0.5, 0.999};
    for (int sign = -1; sign <= 1; sign += 2) {
        const dal__sign_changes found = changes_of(DAL_LENGTH(zeros), zeros, 3.0 * sign);
        CHECK(found.count == DAL_LENGTH(inside) && isnan(found.touch));
        for (size_t k = 0; k < DAL_LENGTH(inside) && k < found.count; k++)
            CHECK(fabs(found.at[k] - inside[k]) < 1e-8);
        CHECK(found.first == sign && found.last == -sign);
    }
}

static void test_a_zero_at_the_middle(void)
{
    const double zeros[] = {0.5, 0.25, 0.75, 0.125}; /* where intervals are halved */
    const dal__sign_changes found = changes_of(DAL_LENGTH(zeros), zeros, 1.0);
    CHECK(found.count == 4);
    for (size_t k = 1; k < found.count; k++) CHECK(found.at[k] > found.at[k - 1]);
}

static void test_touches(void)
{
    const double twice[] = {0.4, 0.4}, thrice[] = {0.4, 0.4, 0.4}, both[] = {0.7, 0.7, 0.2};
    const double far[] = {0.6, 0.6, -3.0};
    dal__sign_changes found = changes_of(2, twice, 1.0);
    CHECK(found.count == 0 && fabs(found.touch - 0.4) < 1e-6);
    found = changes_of(3, thrice, 1.0);
    CHECK(found.count == 1 && fabs(found.at[0] - 0.4) < 1e-4);
    found = changes_of(3, both, 1.0);
    CHECK(found.count == 1 && fabs(found.at[0] - 0.2) < 1e-14 && fabs(found.touch - 0.7) < 1e-6);
    found = changes_of(3, far, -2.0);
    CHECK(found.count == 0 && fabs(found.touch - 0.6) < 1e-6 && found.first == -1);
}

/* s^2/2 - s/2 + 1/8 + rise has two zeros, none or one touch, as near as the noise. */
static void test_noise(void)
{
    dal__sign_changes found;
    for (int k = 4; k <= 15; k++) {
        const double rise = pow(10.0, -k);
        double c[3] = {0.125 - rise, -0.5, 0.5};
        dal__find_sign_changes(2, c, 0.0, &found);
        CHECK(found.count == 2);
        CHECK(fabs(found.at[0] - (0.5 - sqrt(2.0 * rise))) < 1e-9);
        dal__find_sign_changes(2, c, 3.0 * rise, &found);
        CHECK(found.count == 0 && fabs(found.touch - 0.5) < 0.1);
        c[0] = 0.125 + rise;
        dal__find_sign_changes(2, c, 0.0, &found);
        CHECK(found.count == 0 && isnan(found.touch));
    }
}

static void test_nothing(void)
{
    const double zero[3] = {0.0}, ends[3] = {0.0, 1.0, -1.0}, constant[1] = {2.0};
    dal__sign_changes found;
    dal__find_sign_changes(2, zero, 0.0, &found);
    CHECK(found.count == 0 && found.first == 0 && found.last == 0 && isnan(found.touch));
    dal__find_sign_changes(2, ends, 0.0, &found); /* s (1 - s) */
    CHECK(found.count == 0 && found.first == 1 && isnan(found.touch));
    dal__find_sign_changes(0, constant, 0.0, &found);
    CHECK(found.count == 0 && found.first == 1 && found.last == 1);
}

/* sin(8 s) to order 40: all its zeros, in order. */
static void test_a_wave(void)
{
    double c[DAL_ROOTS_MOST + 1] = {0.0}, term = 1.0;
    dal__sign_changes found;
    for (size_t k = 1; k <= DAL_ROOTS_MOST; k++) {
        term *= 8.0 / (double)k;
        c[k] = k % 2 == 0 ? 0.0 : k % 4 == 1 ? term : -term;
    }
    dal__find_sign_changes(DAL_ROOTS_MOST, c, 0.0, &found);
    CHECK(found.count == 2);
    for (size_t k = 0; k < found.count; k++)
        CHECK(fabs(found.at[k] - (double)(k + 1) * acos(-1.0) / 8.0) < 1e-11);
}

int main(void)
{
    test_simple_zeros();
    test_a_zero_at_the_middle();
    test_touches();
    test_noise();
    test_nothing();
    test_a_wave();
    return check_done();
}
