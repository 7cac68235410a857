/* SPDX-License-Identifier: Apache-2.0 */
#include "controller.h"

#include <math.h>

static const double PI = 3.14159265358979323846;

static double dot(const double *row, const double *values, int count)
{
    double sum = 0.0;
    for (int j = 0; j < count; j++)
        sum += row[j] * values[j];
    return sum;
}

static int all_finite(const double *values, int count)
{
    for (int i = 0; i < count; i++)
        if (!isfinite(values[i]))
            return 0;
    return 1;
}

static double within(double value, double least, double greatest)
{
    return value > greatest ? greatest : value < least ? least : value;
}

/* The share of a half cosine from 0 to 1 after so many of its samples. */
static double half_cosine(long samples, long of)
{
    return samples >= of ? 1.0 : (1.0 - cos(PI * (double)samples / (double)of)) / 2.0;
}

/* Limit each wanted force to the capacity, and to the rate limit from the force before it. */
static void act(abrace_controller *controller, const double *wanted)
{
    for (int i = 0; i < ABRACE_COMMANDS; i++) {
        const double before = controller->force[i], step = abrace_rate_limit[i] * ABRACE_SAMPLE_PERIOD;
        const double force = within(wanted[i], -abrace_force_limit[i], abrace_force_limit[i]);
        controller->force[i] = within(force, before - step, before + step);
    }
}

static void begin(abrace_controller *controller, const double *from)
{
    for (int i = 0; i < ABRACE_COMMANDS; i++)
        controller->initial[i] = from[i];
    controller->samples = 0;
}

static int come_to_rest(abrace_controller *controller)
{
    double wanted[ABRACE_COMMANDS];
    if (controller->samples < ABRACE_STOP_SAMPLES)
        controller->samples++;
    for (int i = 0; i < ABRACE_COMMANDS; i++)
        wanted[i] = (1.0 - half_cosine(controller->samples, ABRACE_STOP_SAMPLES)) * controller->initial[i];
    act(controller, wanted);
    return 1;
}

static int stop(abrace_controller *controller)
{
    controller->stopped = 1;
    begin(controller, controller->force);
    return come_to_rest(controller);
}

void abrace_controller_start(abrace_controller *controller, const double acting[])
{
    for (int i = 0; i < ABRACE_STATES; i++)
        controller->state[i] = 0.0;
    for (int i = 0; i < ABRACE_COMMANDS; i++)
        controller->force[i] = acting[i];
    controller->stopped = !all_finite(acting, ABRACE_COMMANDS);
    if (controller->stopped)
        for (int i = 0; i < ABRACE_COMMANDS; i++)
            controller->force[i] = 0.0;
    controller->held = 0;
    begin(controller, controller->force);
}

/* The law's answer to a sample; 0: it is not finite. */
static int answer(abrace_controller *controller, const double *measured)
{
    double *law = controller->law;
    for (int i = 0; i < ABRACE_COMMANDS; i++)
        law[i] = dot(abrace_c[i], controller->state, ABRACE_STATES) + dot(abrace_d[i], measured, ABRACE_MEASURED);
    if (!all_finite(law, ABRACE_COMMANDS))
        return 0;
    if (controller->samples < ABRACE_FADE_SAMPLES)
        controller->samples++;
    for (int i = 0; i < ABRACE_COMMANDS; i++) {
        controller->wanted[i] = controller->initial[i] + half_cosine(controller->samples, ABRACE_FADE_SAMPLES) *
                                                             (law[i] - controller->initial[i]);
        controller->more[i] = 0.0;
    }
    for (int i = 0; i < ABRACE_STATES; i++)
        controller->next[i] =
            dot(abrace_a[i], controller->state, ABRACE_STATES) + dot(abrace_b[i], measured, ABRACE_MEASURED);
    return 1;
}

int abrace_controller_step(abrace_controller *controller, const double measured[])
{
    double difference[ABRACE_COMMANDS];
    if (controller->stopped)
        return come_to_rest(controller);
    if (!all_finite(measured, ABRACE_MEASURED) || (!controller->held && !answer(controller, measured)))
        return stop(controller);
    act(controller, controller->wanted);
    for (int i = 0; i < ABRACE_COMMANDS; i++) {
        if (!controller->held)
            controller->first[i] = controller->force[i];
        controller->more[i] += controller->force[i] - controller->first[i];
        difference[i] = controller->first[i] + controller->more[i] / ABRACE_HELD_SAMPLES - controller->law[i];
    }
    if (++controller->held < ABRACE_HELD_SAMPLES)
        return 0;
    controller->held = 0;
    for (int i = 0; i < ABRACE_STATES; i++)
        controller->state[i] = controller->next[i] + dot(abrace_g[i], difference, ABRACE_COMMANDS);
    return 0;
}
