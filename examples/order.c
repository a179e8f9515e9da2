/* order.c - measures the order of a scheme by step-size refinement on the knife edge on an incline.
 *
 *     L = m (v_x^2 + v_y^2)/2 + J v_theta^2/2 + m g x,   sin(theta) v_x - cos(theta) v_y = 0
 *     the default initial data of the built-in system; t from 0 to 1
 *
 * Prints for each step size the errors of q, v and of the multiplier lambda(q, v) at t = 1, and the
 * worst residual of D.  Then come the orders (p, s), the promised ones, and the verdict.  p and s
 * are slopes of the errors of one step, minus 1.
 *
 *     cc order.c $(pkg-config --cflags --libs dalembert) -o order && ./order [SCHEME]
 */
#include <dalembert/study.h>
#include <stdio.h>

enum { POINTS = 6 };

int main(int count, char **arguments)
{
    const size_t steps[POINTS] = {80, 120, 160, 240, 320, 480};
    double x0[6];
    dal_system *system;
    dal_scheme scheme;
    dal_error error;
    if (dal_system_builtin(&system, "knife-edge", NULL, NULL, 0, &error)
        || dal_scheme_find(&scheme, count > 1 ? arguments[1] : "midpoint", &error)) {
        fprintf(stderr, "%s\n", error.text);
        return 1;
    }
    if (dal_system_state(system, x0)) return 1;

    const dal_order_def def = {.t0 = 0.0, .t_end = 1.0, .x0 = x0, .steps = steps, .count = POINTS};
    dal_order_point points[POINTS];
    dal_order order;
    if (dal_order_study(system, &scheme, &def, points, &order, &error)) {
        fprintf(stderr, "%s\n", error.text);
        return 1;
    }
    printf("%s on %s\n", scheme.name, dal_system_name(system));
    printf("         h    error of q    of v          of lambda     residual of D\n");
    for (int k = 0; k < POINTS; k++)
        printf("%10.7f    %.3e     %.3e     %.3e     %.1e\n", points[k].h, points[k].q,
               points[k].v, points[k].multipliers, points[k].residual);
    printf("(p, s)   measured %.3f %.3f   promised %d %d\n", order.p, order.s, scheme.order,
           scheme.multiplier_order);
    printf("%s\n", order.text);

    dal_system_free(system);
    return order.holds == 0;
}
