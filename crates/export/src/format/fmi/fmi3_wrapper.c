/* FMI 3.0 co-simulation around one program: inputs set at t act on the step from t, outputs show it at t + h. */
static const double START[N_IN] = START_VALUES;

typedef struct {
    P_state_T program;
    double time;
    double in[N_IN];
    double out[N_OUT];
} Memory;

static void defaults(Memory *m)
{
    memset(m, 0, sizeof(Memory));
    memcpy(m->in, START, sizeof(START));
    P_init(&m->program);
}

static double *variable(Memory *m, fmi3ValueReference v)
{
    double *p = NULL;
    if (v == 0U) {
        p = &m->time;
    } else if (v <= INPUTS) {
        p = &m->in[v - 1U];
    } else if (v <= (INPUTS + N_OUT)) {
        p = &m->out[v - 1U - INPUTS];
    } else {
        /* no such variable */
    }
    return p;
}

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)instance; (void)on; (void)n; (void)categories;
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return, const fmi3ValueReference intermediate[],
    size_t n_intermediate, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update)
{
    Memory *m = NULL;
    (void)name; (void)resources; (void)visible; (void)logging; (void)event_mode; (void)early_return;
    (void)intermediate; (void)n_intermediate; (void)environment; (void)log; (void)update;
    if ((token != NULL) && (strcmp(token, GUID) == 0)) {
        m = (Memory *)malloc(sizeof(Memory));
        if (m != NULL) {
            defaults(m);
        }
    }
    return m;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
    fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop)
{
    (void)tolerance_defined; (void)tolerance; (void)stop_defined; (void)stop;
    ((Memory *)instance)->time = start;
    return fmi3OK;
}

/* Outputs before the first step: what the first step would give for the inputs as they are. */
fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    Memory *m = (Memory *)instance;
    P_state_T trial = m->program;
    P_step(&trial, m->in, m->out);
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance) { (void)instance; return fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance instance) { defaults((Memory *)instance); return fmi3OK; }

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t nv)
{
    fmi3Status status = (n == nv) ? fmi3OK : fmi3Error;
    for (size_t k = 0U; (k < n) && (status == fmi3OK); k++) {
        const double *p = variable((Memory *)instance, vr[k]);
        if (p == NULL) {
            status = fmi3Error;
        } else {
            value[k] = *p;
        }
    }
    return status;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
    size_t nv)
{
    fmi3Status status = (n == nv) ? fmi3OK : fmi3Error;
    for (size_t k = 0U; (k < n) && (status == fmi3OK); k++) {
        if ((vr[k] == 0U) || (vr[k] > INPUTS)) {
            status = fmi3Error;
        } else {
            ((Memory *)instance)->in[vr[k] - 1U] = value[k];
        }
    }
    return status;
}

/* A communication step is a whole number of samples. */
fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_set_state, fmi3Boolean *event,
    fmi3Boolean *terminate, fmi3Boolean *early_return, fmi3Float64 *last)
{
    Memory *m = (Memory *)instance;
    fmi3Status status = fmi3Discard;
    const double samples = h / SAMPLE_TIME;
    const long n = (long)(samples + 0.5);
    const double off = samples - (double)n;
    (void)no_set_state;
    *event = false;
    *terminate = false;
    *early_return = false;
    *last = t;
    if ((n > 0) && (off < 1e-6) && (off > -1e-6)) {
        for (long k = 0; k < n; k++) {
            P_step(&m->program, m->in, m->out);
        }
        m->time = t + h;
        *last = t + h;
        status = fmi3OK;
    }
    return status;
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    if (*state == NULL) {
        *state = malloc(sizeof(Memory));
    }
    if (*state != NULL) {
        memcpy(*state, instance, sizeof(Memory));
    }
    return (*state != NULL) ? fmi3OK : fmi3Error;
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    memcpy(instance, state, sizeof(Memory));
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    (void)instance;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *n)
{
    (void)instance; (void)state;
    *n = sizeof(Memory);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t n)
{
    (void)instance;
    memcpy(bytes, state, (n < sizeof(Memory)) ? n : sizeof(Memory));
    return (n == sizeof(Memory)) ? fmi3OK : fmi3Error;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t n, fmi3FMUState *state)
{
    fmi3Status status = fmi3Error;
    if (n == sizeof(Memory)) {
        status = fmi3GetFMUState(instance, state);
        if (status == fmi3OK) {
            memcpy(*state, bytes, n);
        }
    }
    return status;
}

