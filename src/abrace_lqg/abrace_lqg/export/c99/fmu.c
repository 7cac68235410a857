/* SPDX-License-Identifier: Apache-2.0
 *
 * The controller as a unit of FMI 2.0 for co-simulation. Value references: 0 ... for the measured values, then those of
 * the forces; of the booleans, 0 is `stopped`. A step is one sample period: the measured values are those at its
 * beginning, the forces what acts from its end on. */
#include "controller.h"

#include <math.h>
#include <stddef.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef void *component;
typedef unsigned int reference;
typedef int boolean;
typedef int status;
enum { OK, WARNING, DISCARD, ERROR };
enum { CO_SIMULATION = 1 };

typedef struct {
    void (*log)(void *environment, const char *instance, status, const char *category, const char *message, ...);
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    void (*step_finished)(void *environment, status);
    void *environment;
} callbacks;

typedef struct {
    abrace_controller controller;
    double measured[ABRACE_MEASURED];
    callbacks given;
} unit;

static const double NONE[ABRACE_COMMANDS];

static status refuse(unit *self, const char *message)
{
    if (self->given.log)
        self->given.log(self->given.environment, "controller", ERROR, "error", message);
    return ERROR;
}

static void begin(unit *self)
{
    for (int i = 0; i < ABRACE_MEASURED; i++)
        self->measured[i] = 0.0;
    abrace_controller_start(&self->controller, NONE);
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT status fmi2SetDebugLogging(component c, boolean on, size_t count, const char *const categories[])
{
    (void)c, (void)on, (void)count, (void)categories;
    return OK;
}

EXPORT component fmi2Instantiate(const char *name, int kind, const char *guid, const char *resources,
                                 const callbacks *given, boolean visible, boolean logging)
{
    (void)name, (void)guid, (void)resources, (void)visible, (void)logging;
    if (kind != CO_SIMULATION || given == NULL || given->allocate == NULL || given->release == NULL)
        return NULL;
    unit *self = given->allocate(1, sizeof(unit));
    if (self == NULL)
        return NULL;
    self->given = *given;
    begin(self);
    return self;
}

EXPORT void fmi2FreeInstance(component c)
{
    unit *self = c;
    if (self != NULL)
        self->given.release(self);
}

EXPORT status fmi2SetupExperiment(component c, boolean tolerance_given, double tolerance, double start,
                                  boolean stop_given, double stop)
{
    (void)c, (void)tolerance_given, (void)tolerance, (void)start, (void)stop_given, (void)stop;
    return OK;
}

EXPORT status fmi2EnterInitializationMode(component c) { (void)c; return OK; }
EXPORT status fmi2ExitInitializationMode(component c) { (void)c; return OK; }
EXPORT status fmi2Terminate(component c) { (void)c; return OK; }

EXPORT status fmi2Reset(component c)
{
    begin(c);
    return OK;
}

EXPORT status fmi2GetReal(component c, const reference references[], size_t count, double values[])
{
    unit *self = c;
    for (size_t i = 0; i < count; i++) {
        if (references[i] >= ABRACE_MEASURED + ABRACE_COMMANDS)
            return refuse(self, "no real variable of this value reference");
        values[i] = references[i] < ABRACE_MEASURED ? self->measured[references[i]]
                                                    : self->controller.force[references[i] - ABRACE_MEASURED];
    }
    return OK;
}

EXPORT status fmi2SetReal(component c, const reference references[], size_t count, const double values[])
{
    unit *self = c;
    for (size_t i = 0; i < count; i++) {
        if (references[i] >= ABRACE_MEASURED)
            return refuse(self, "no input of this value reference");
        self->measured[references[i]] = values[i];
    }
    return OK;
}

EXPORT status fmi2GetBoolean(component c, const reference references[], size_t count, boolean values[])
{
    unit *self = c;
    for (size_t i = 0; i < count; i++) {
        if (references[i] != 0)
            return refuse(self, "no boolean variable of this value reference");
        values[i] = self->controller.stopped;
    }
    return OK;
}

EXPORT status fmi2DoStep(component c, double time, double step, boolean keeps_state)
{
    unit *self = c;
    (void)time, (void)keeps_state;
    if (!(fabs(step - ABRACE_SAMPLE_PERIOD) <= 1e-6 * ABRACE_SAMPLE_PERIOD))
        return refuse(self, "expected steps of one sample period, the stepSize of the unit's default experiment");
    abrace_controller_step(&self->controller, self->measured); /* once stopped, the force goes to zero by itself */
    return OK;
}

/* What a unit without such variables or abilities answers. */
#define ABSENT(name, ...)                                                                                              \
    EXPORT status name(__VA_ARGS__)                                                                                    \
    {                                                                                                                  \
        return ERROR;                                                                                                  \
    }
#pragma GCC diagnostic ignored "-Wunused-parameter"
#define VALUES component c, const reference references[], size_t count
static status none(size_t count) { return count ? ERROR : OK; }
EXPORT status fmi2GetInteger(VALUES, int values[]) { return none(count); }
EXPORT status fmi2GetString(VALUES, const char *values[]) { return none(count); }
EXPORT status fmi2SetInteger(VALUES, const int values[]) { return none(count); }
EXPORT status fmi2SetBoolean(VALUES, const boolean values[]) { return none(count); }
EXPORT status fmi2SetString(VALUES, const char *const values[]) { return none(count); }
ABSENT(fmi2GetFMUstate, component c, void **state)
ABSENT(fmi2SetFMUstate, component c, void *state)
ABSENT(fmi2FreeFMUstate, component c, void **state)
ABSENT(fmi2SerializedFMUstateSize, component c, void *state, size_t *size)
ABSENT(fmi2SerializeFMUstate, component c, void *state, char bytes[], size_t size)
ABSENT(fmi2DeSerializeFMUstate, component c, const char bytes[], size_t size, void **state)
ABSENT(fmi2GetDirectionalDerivative, component c, const reference unknown[], size_t unknowns, const reference known[],
       size_t knowns, const double seed[], double derivative[])
ABSENT(fmi2SetRealInputDerivatives, VALUES, const int order[], const double values[])
ABSENT(fmi2GetRealOutputDerivatives, VALUES, const int order[], double values[])
ABSENT(fmi2CancelStep, component c)
ABSENT(fmi2GetStatus, component c, int kind, status *value)
ABSENT(fmi2GetRealStatus, component c, int kind, double *value)
ABSENT(fmi2GetIntegerStatus, component c, int kind, int *value)
ABSENT(fmi2GetBooleanStatus, component c, int kind, boolean *value)
ABSENT(fmi2GetStringStatus, component c, int kind, const char **value)
