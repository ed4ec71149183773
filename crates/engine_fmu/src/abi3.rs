//! FMI 3.0: the names and signatures of its C interface, around [`unit`].

use std::ffi::{CString, c_char, c_int, c_uint, c_void};

use crate::unit::{self, ERROR, Log, OK, text};

type Logger = unsafe extern "C" fn(*mut c_void, c_int, *const c_char, *const c_char);

fn messages(logger: Option<Logger>, environment: *mut c_void) -> Log {
    Box::new(move |message| {
        let Some(log) = logger else { return };
        let Ok(message) = CString::new(message) else { return };
        // SAFETY: the importer's own function, called as the standard says.
        unsafe { log(environment, ERROR, c"logStatusError".as_ptr(), message.as_ptr()) };
    })
}

#[unsafe(no_mangle)]
pub extern "C" fn fmi3GetVersion() -> *const c_char {
    c"3.0".as_ptr()
}

#[unsafe(no_mangle)]
pub extern "C" fn fmi3SetDebugLogging(_: *mut c_void, _: bool, _: usize, _: *const *const c_char) -> c_int {
    OK
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3InstantiateCoSimulation(
    _name: *const c_char,
    token: *const c_char,
    resources: *const c_char,
    _visible: bool,
    _logging: bool,
    _event_mode: bool,
    _early_return: bool,
    _intermediate: *const c_uint,
    _n_intermediate: usize,
    environment: *mut c_void,
    logger: Option<Logger>,
    _update: *const c_void,
) -> *mut c_void {
    // SAFETY: strings are the importer's, as the standard says; null is allowed here.
    let (token, resources) = unsafe { (text(token), text(resources)) };
    unit::create(&token, &resources, messages(logger, environment))
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3FreeInstance(c: *mut c_void) {
    // SAFETY: an instance of ours.
    unsafe { unit::free(c) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3EnterInitializationMode(
    c: *mut c_void,
    _tolerance_defined: bool,
    _tolerance: f64,
    start: f64,
    _stop_defined: bool,
    _stop: f64,
) -> c_int {
    // SAFETY: an instance of ours.
    unsafe { unit::start_at(c, start) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3ExitInitializationMode(c: *mut c_void) -> c_int {
    // SAFETY: an instance of ours.
    unsafe { unit::start(c) }
}

#[unsafe(no_mangle)]
pub extern "C" fn fmi3Terminate(_: *mut c_void) -> c_int {
    OK
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3Reset(c: *mut c_void) -> c_int {
    // SAFETY: an instance of ours.
    unsafe { unit::reset(c) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3GetFloat64(
    c: *mut c_void,
    vr: *const c_uint,
    n: usize,
    value: *mut f64,
    n_values: usize,
) -> c_int {
    // SAFETY: an instance of ours, arrays of n and n_values entries; every variable is a scalar.
    unsafe { if n == n_values { unit::get(c, vr, n, value) } else { ERROR } }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SetFloat64(
    c: *mut c_void,
    vr: *const c_uint,
    n: usize,
    value: *const f64,
    n_values: usize,
) -> c_int {
    // SAFETY: an instance of ours, arrays of n and n_values entries; every variable is a scalar.
    unsafe { if n == n_values { unit::set(c, vr, n, value) } else { ERROR } }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3DoStep(
    c: *mut c_void,
    time: f64,
    step: f64,
    _no_set_state: bool,
    event: *mut bool,
    terminate: *mut bool,
    early: *mut bool,
    last: *mut f64,
) -> c_int {
    // SAFETY: an instance of ours; the four results are the importer's.
    unsafe {
        let status = unit::step(c, time, step);
        let end = if status == OK { time + step } else { time };
        (*event, *terminate, *early, *last) = (false, false, false, end);
        status
    }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3GetFMUState(c: *mut c_void, state: *mut *mut c_void) -> c_int {
    // SAFETY: an instance and a state of ours (or none yet).
    unsafe { unit::save(c, state) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SetFMUState(c: *mut c_void, state: *mut c_void) -> c_int {
    // SAFETY: an instance and a state of ours.
    unsafe { unit::restore(c, state) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3FreeFMUState(_: *mut c_void, state: *mut *mut c_void) -> c_int {
    // SAFETY: a state of ours, freed once.
    unsafe { unit::free_state(state) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SerializedFMUStateSize(
    _: *mut c_void,
    state: *mut c_void,
    n: *mut usize,
) -> c_int {
    // SAFETY: a state of ours.
    unsafe { unit::size(state, n) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SerializeFMUState(
    _: *mut c_void,
    state: *mut c_void,
    bytes: *mut u8,
    n: usize,
) -> c_int {
    // SAFETY: a state of ours, a buffer of n bytes.
    unsafe { unit::serialise(state, bytes, n) }
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3DeserializeFMUState(
    c: *mut c_void,
    bytes: *const u8,
    n: usize,
    state: *mut *mut c_void,
) -> c_int {
    // SAFETY: an instance of ours, a buffer of n bytes.
    unsafe { unit::deserialise(c, bytes, n, state) }
}
