//! FMI 2.0: the names and signatures of its C interface, around [`unit`].

use std::ffi::{CStr, CString, c_char, c_int, c_uint, c_void};

use crate::unit::{self, ERROR, Log, OK, text};

type Logger = unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);

/// `fmi2CallbackFunctions`.
#[repr(C)]
pub struct Callbacks {
    logger: Option<Logger>,
    allocate: *const c_void,
    free: *const c_void,
    finished: *const c_void,
    environment: *mut c_void,
}

fn messages(name: CString, logger: Option<Logger>, environment: *mut c_void) -> Log {
    Box::new(move |message| {
        let Some(log) = logger else { return };
        // The importer reads the message as a format.
        let Ok(message) = CString::new(message.replace('%', "%%")) else { return };
        let category: &CStr = c"logStatusError";
        // SAFETY: the importer's own function, called as the standard says.
        unsafe { log(environment, name.as_ptr(), ERROR, category.as_ptr(), message.as_ptr()) };
    })
}

#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetTypesPlatform() -> *const c_char {
    c"default".as_ptr()
}

#[unsafe(no_mangle)]
pub extern "C" fn fmi2GetVersion() -> *const c_char {
    c"2.0".as_ptr()
}

#[unsafe(no_mangle)]
pub extern "C" fn fmi2SetDebugLogging(_: *mut c_void, _: c_int, _: usize, _: *const *const c_char) -> c_int {
    OK
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2Instantiate(
    name: *const c_char,
    kind: c_int,
    guid: *const c_char,
    resources: *const c_char,
    callbacks: *const Callbacks,
    _visible: c_int,
    _logging: c_int,
) -> *mut c_void {
    // SAFETY: strings and callbacks are the importer's, as the standard says; null is allowed here.
    let (name, guid, resources, callbacks) =
        unsafe { (text(name), text(guid), text(resources), callbacks.as_ref()) };
    let (logger, environment) = callbacks.map_or((None, std::ptr::null_mut()), |c| (c.logger, c.environment));
    let log = messages(CString::new(name).unwrap_or_default(), logger, environment);
    if kind != 1 {
        log("found model exchange, expected co-simulation");
        return std::ptr::null_mut();
    }
    unit::create(&guid, &resources, log)
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeInstance(c: *mut c_void) {
    // SAFETY: an instance of ours.
    unsafe { unit::free(c) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetupExperiment(
    c: *mut c_void,
    _tolerance_defined: c_int,
    _tolerance: f64,
    start: f64,
    _stop_defined: c_int,
    _stop: f64,
) -> c_int {
    // SAFETY: an instance of ours.
    unsafe { unit::start_at(c, start) }
}

#[unsafe(no_mangle)]
pub extern "C" fn fmi2EnterInitializationMode(_: *mut c_void) -> c_int {
    OK
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2ExitInitializationMode(c: *mut c_void) -> c_int {
    // SAFETY: an instance of ours.
    unsafe { unit::start(c) }
}

#[unsafe(no_mangle)]
pub extern "C" fn fmi2Terminate(_: *mut c_void) -> c_int {
    OK
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2Reset(c: *mut c_void) -> c_int {
    // SAFETY: an instance of ours.
    unsafe { unit::reset(c) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetReal(c: *mut c_void, vr: *const c_uint, n: usize, value: *mut f64) -> c_int {
    // SAFETY: an instance of ours, arrays of n entries.
    unsafe { unit::get(c, vr, n, value) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetReal(
    c: *mut c_void,
    vr: *const c_uint,
    n: usize,
    value: *const f64,
) -> c_int {
    // SAFETY: an instance of ours, arrays of n entries.
    unsafe { unit::set(c, vr, n, value) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2DoStep(c: *mut c_void, time: f64, step: f64, _no_set_state: c_int) -> c_int {
    // SAFETY: an instance of ours.
    unsafe { unit::step(c, time, step) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetFMUstate(c: *mut c_void, state: *mut *mut c_void) -> c_int {
    // SAFETY: an instance and a state of ours (or none yet).
    unsafe { unit::save(c, state) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetFMUstate(c: *mut c_void, state: *mut c_void) -> c_int {
    // SAFETY: an instance and a state of ours.
    unsafe { unit::restore(c, state) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeFMUstate(_: *mut c_void, state: *mut *mut c_void) -> c_int {
    // SAFETY: a state of ours, freed once.
    unsafe { unit::free_state(state) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SerializedFMUstateSize(
    _: *mut c_void,
    state: *mut c_void,
    n: *mut usize,
) -> c_int {
    // SAFETY: a state of ours.
    unsafe { unit::size(state, n) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SerializeFMUstate(
    _: *mut c_void,
    state: *mut c_void,
    bytes: *mut u8,
    n: usize,
) -> c_int {
    // SAFETY: a state of ours, a buffer of n bytes.
    unsafe { unit::serialise(state, bytes, n) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2DeSerializeFMUstate(
    c: *mut c_void,
    bytes: *const u8,
    n: usize,
    state: *mut *mut c_void,
) -> c_int {
    // SAFETY: an instance of ours, a buffer of n bytes.
    unsafe { unit::deserialise(c, bytes, n, state) }
}
