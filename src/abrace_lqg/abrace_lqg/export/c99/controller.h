/* SPDX-License-Identifier: Apache-2.0
 *
 * The control law of abrace's node `controller` in C99: no heap, no library but <math.h>. The sizes and matrices are in
 * constants.h and constants.c, which `abrace export` wrote. All values are SI units.
 *
 *     static abrace_controller controller;
 *     abrace_controller_start(&controller, force);          once, before the first sample
 *     every ABRACE_SAMPLE_PERIOD seconds, also of a slower law, which answers one of ABRACE_HELD_SAMPLES:
 *         measured[] = ...                                  in the order that constants.h lists
 *         abrace_controller_step(&controller, measured);
 *         output controller.force[] at the next sample      one command acts for one sample period
 */
#ifndef ABRACE_CONTROLLER_H
#define ABRACE_CONTROLLER_H

#include "constants.h"

typedef struct {
    double force[ABRACE_COMMANDS];      /* the last command, limited and faded, in its unit (constants.h) */
    int stopped;                        /* not 0: a value was not finite; the force goes to zero, and stays there */
    double state[ABRACE_STATES];        /* q of Eq. (13) */
    double initial[ABRACE_COMMANDS];    /* N, from which the force fades in, or is ramped to zero */
    long samples;                       /* answered since the start, or all since it was stopped */
    long held;                          /* samples of the last answer so far; 0: the next one is answered */
    double law[ABRACE_COMMANDS];        /* U of Eq. (13), and what is wanted of the force */
    double wanted[ABRACE_COMMANDS];
    double first[ABRACE_COMMANDS];      /* the force with the answer, and how much more it was since, summed */
    double more[ABRACE_COMMANDS];
    double next[ABRACE_STATES];         /* A q + B y */
} abrace_controller;

/* Begin with the estimate at zero; the command fades in from the force that acts, ABRACE_COMMANDS values [N]. */
void abrace_controller_start(abrace_controller *controller, const double acting[]);

/* Answer a sample of ABRACE_MEASURED values. Returns 0, or 1 once the controller is stopped: then only
 * abrace_controller_start makes it command again. */
int abrace_controller_step(abrace_controller *controller, const double measured[]);

#endif
