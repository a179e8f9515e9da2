/* particle.c - the free particle with a nonholonomic constraint, by the midpoint scheme.
 *
 *     L = (v_x^2 + v_y^2 + v_z^2)/2,   v_z = y v_x,   that is mu(q) = (-y, 0, 1)
 *     q = (0, 1, 0), v = (1, 1, 1) at t = 0;  h = 0.01, 1000 steps
 *
 * Prints the last position beside the exact one, the band of the energy, and the worst residual of
 * D, which docs/residual.md defines.
 *
 *     cc particle.c $(pkg-config --cflags --libs dalembert) -o particle && ./particle
 */
#include <dalembert/geometry.h>
#include <math.h>
#include <stdio.h>

enum { STEPS = 1000 };

int main(void)
{
    const double x0[6] = {0.0, 1.0, 0.0, 1.0, 1.0, 1.0}, h = 0.01;
    double x[STEPS + 1][6], exact[6], energy[STEPS + 1], residual[STEPS + 1];
    dal_system *system;
    dal_mechanics *mechanics;
    dal_scheme scheme;
    dal_stepper *stepper;
    dal_error error;
    if (dal_system_builtin(&system, "particle", NULL, NULL, 0, &error)
        || dal_mechanics_new(&mechanics, system, &error)
        || dal_scheme_find(&scheme, "midpoint", &error)
        || dal_stepper_new(&stepper, system, &scheme, NULL, &error)) {
        fprintf(stderr, "%s\n", error.text);
        return 1;
    }
    if (dal_stepper_start(stepper, 0.0, h, x0, DAL_CHECK, DAL_INITIAL_NONE)
        || dal_integrate(stepper, STEPS, 1, x[0], NULL, NULL, NULL, NULL)
        || dal_system_exact(system, STEPS * h, x0, exact)
        || dal_trajectory(mechanics, 0.0, h, 0.0, STEPS + 1, x[0], NULL, energy, NULL, NULL,
                          residual, NULL)) {
        fprintf(stderr, "%s%s\n", dal_stepper_error(stepper)->text,
                dal_mechanics_error(mechanics)->text);
        return 1;
    }
    double least = energy[0], most = energy[0], worst = residual[0];
    for (int k = 1; k <= STEPS; k++) {
        least = fmin(least, energy[k]);
        most = fmax(most, energy[k]);
        worst = fmax(worst, residual[k]);
    }
    printf("q(10)   %.9f %.9f %.9f\n", x[STEPS][0], x[STEPS][1], x[STEPS][2]);
    printf("exact   %.9f %.9f %.9f\n", exact[0], exact[1], exact[2]);
    printf("energy  from %.12f to %.12f\n", least, most);
    printf("worst residual of D %.1e\n", worst);

    dal_stepper_free(stepper);
    dal_mechanics_free(mechanics);
    dal_system_free(system);
    return 0;
}
