/* FMI 2.0 co-simulation around one program: inputs set at t act on the step from t, outputs show it at t + h. */
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

static double *variable(Memory *m, fmi2ValueReference v)
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

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c; (void)on; (void)n; (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
    const void *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    Memory *m = NULL;
    (void)name; (void)resources; (void)functions; (void)visible; (void)logging;
    if ((type == fmi2CoSimulation) && (guid != NULL) && (strcmp(guid, GUID) == 0)) {
        m = (Memory *)malloc(sizeof(Memory));
        if (m != NULL) {
            defaults(m);
        }
    }
    return m;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
    fmi2Boolean stop_defined, fmi2Real stop)
{
    (void)tolerance_defined; (void)tolerance; (void)stop_defined; (void)stop;
    ((Memory *)c)->time = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }

/* Outputs before the first step: what the first step would give for the inputs as they are. */
fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Memory *m = (Memory *)c;
    P_state_T trial = m->program;
    P_step(&trial, m->in, m->out);
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { defaults((Memory *)c); return fmi2OK; }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    fmi2Status status = fmi2OK;
    for (size_t k = 0U; k < n; k++) {
        const double *p = variable((Memory *)c, vr[k]);
        if (p == NULL) {
            status = fmi2Error;
        } else {
            value[k] = *p;
        }
    }
    return status;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    fmi2Status status = fmi2OK;
    for (size_t k = 0U; k < n; k++) {
        if ((vr[k] == 0U) || (vr[k] > INPUTS)) {
            status = fmi2Error;
        } else {
            ((Memory *)c)->in[vr[k] - 1U] = value[k];
        }
    }
    return status;
}

/* A communication step is a whole number of samples. */
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_set_state)
{
    Memory *m = (Memory *)c;
    fmi2Status status = fmi2Discard;
    const double samples = h / SAMPLE_TIME;
    const long n = (long)(samples + 0.5);
    const double off = samples - (double)n;
    (void)no_set_state;
    if ((n > 0) && (off < 1e-6) && (off > -1e-6)) {
        for (long k = 0; k < n; k++) {
            P_step(&m->program, m->in, m->out);
        }
        m->time = t + h;
        status = fmi2OK;
    }
    return status;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (*state == NULL) {
        *state = malloc(sizeof(Memory));
    }
    if (*state != NULL) {
        memcpy(*state, c, sizeof(Memory));
    }
    return (*state != NULL) ? fmi2OK : fmi2Error;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { memcpy(c, state, sizeof(Memory)); return fmi2OK; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) { (void)c; free(*state); *state = NULL; return fmi2OK; }

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *n)
{
    (void)c; (void)state;
    *n = sizeof(Memory);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t n)
{
    (void)c;
    memcpy(bytes, state, (n < sizeof(Memory)) ? n : sizeof(Memory));
    return (n == sizeof(Memory)) ? fmi2OK : fmi2Error;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t n, fmi2FMUstate *state)
{
    fmi2Status status = fmi2Error;
    if (n == sizeof(Memory)) {
        status = fmi2GetFMUstate(c, state);
        if (status == fmi2OK) {
            memcpy(*state, bytes, n);
        }
    }
    return status;
}

