//! FMI 3.0 through its C interface.

use std::ffi::{CString, c_char, c_int, c_uint, c_void};
use std::path::Path;

use libloading::{Library, Symbol};

use crate::description::Description;
use crate::error::FmuError;
use crate::library::{Instance, check, load, unlinked};

type Component = *mut c_void;
type Instantiate = unsafe extern "C" fn(
    *const c_char,
    *const c_char,
    *const c_char,
    bool,
    bool,
    bool,
    bool,
    *const c_uint,
    usize,
    *mut c_void,
    *const c_void,
    *const c_void,
) -> Component;
type Log = unsafe extern "C" fn(*mut c_void, c_int, *const c_char, *const c_char);
type DoStep =
    unsafe extern "C" fn(Component, f64, f64, bool, *mut bool, *mut bool, *mut bool, *mut f64) -> c_int;

/// Messages of a unit are not shown: its status codes say what matters.
unsafe extern "C" fn silent(_: *mut c_void, _: c_int, _: *const c_char, _: *const c_char) {}

pub(crate) struct Unit3 {
    path: String,
    library: Library,
    component: Component,
}

// SAFETY: the instance is only ever reached through `&mut self` or `&self` of one owner, and FMI asks for no thread.
unsafe impl Send for Unit3 {}

impl Unit3 {
    /// Loads `binary` and instantiates the unit.
    pub(crate) fn load(
        path: &str,
        binary: &Path,
        resources: &str,
        about: &Description,
    ) -> Result<Self, FmuError> {
        let fail = |reason: String| FmuError::Library { path: path.into(), reason };
        let library = load(path, binary)?;
        let text = |s: &str| CString::new(s).map_err(|_| fail(format!("`{s}` holds a zero byte")));
        let (name, token, resources) = (text(&about.model)?, text(&about.token)?, text(resources)?);
        // SAFETY: the symbol has this signature by the standard; all pointers live beyond the call.
        let component = unsafe {
            let call: Symbol<Instantiate> =
                library.get(b"fmi3InstantiateCoSimulation\0").map_err(|e| unlinked(path, &e))?;
            let (nothing, none) = (std::ptr::null(), std::ptr::null_mut());
            let log = silent as Log as *const c_void;
            let (name, token, resources) = (name.as_ptr(), token.as_ptr(), resources.as_ptr());
            call(name, token, resources, false, false, false, false, std::ptr::null(), 0, none, log, nothing)
        };
        if component.is_null() {
            return Err(fail("fmi3InstantiateCoSimulation gave no instance: does the token of the description fit the binary?".into()));
        }
        Ok(Self { path: path.into(), library, component })
    }

    fn symbol<T>(&self, name: &'static str) -> Result<Symbol<'_, T>, FmuError> {
        // SAFETY: every caller names the type that the standard gives this function.
        unsafe { self.library.get(name.as_bytes()) }.map_err(|e| unlinked(&self.path, &e))
    }

    fn plain(&self, name: &'static str) -> Result<(), FmuError> {
        let call: Symbol<unsafe extern "C" fn(Component) -> c_int> = self.symbol(name)?;
        // SAFETY: signature by the standard, instance alive.
        check(&self.path, name, unsafe { call(self.component) })
    }
}

impl Drop for Unit3 {
    fn drop(&mut self) {
        if let Ok(call) = self.symbol::<unsafe extern "C" fn(Component)>("fmi3FreeInstance") {
            // SAFETY: the instance came from fmi3InstantiateCoSimulation and is freed once.
            unsafe { call(self.component) };
        }
    }
}

impl Instance for Unit3 {
    fn start(&mut self, parameters: &[(u32, f64)]) -> Result<(), FmuError> {
        self.plain("fmi3Reset")?;
        let (references, values): (Vec<u32>, Vec<f64>) = parameters.iter().copied().unzip();
        self.set(&references, &values)?;
        {
            let call: Symbol<unsafe extern "C" fn(Component, bool, f64, f64, bool, f64) -> c_int> =
                self.symbol("fmi3EnterInitializationMode")?;
            // SAFETY: signature by the standard, instance alive.
            let status = unsafe { call(self.component, false, 0.0, 0.0, false, 0.0) };
            check(&self.path, "fmi3EnterInitializationMode", status)?;
        }
        self.plain("fmi3ExitInitializationMode")
    }

    fn set(&mut self, references: &[u32], values: &[f64]) -> Result<(), FmuError> {
        if references.is_empty() {
            return Ok(());
        }
        let call: Symbol<unsafe extern "C" fn(Component, *const c_uint, usize, *const f64, usize) -> c_int> =
            self.symbol("fmi3SetFloat64")?;
        let n = references.len().min(values.len());
        // SAFETY: both arrays hold n entries.
        check(&self.path, "fmi3SetFloat64", unsafe {
            call(self.component, references.as_ptr(), n, values.as_ptr(), n)
        })
    }

    fn get(&self, references: &[u32], values: &mut [f64]) -> Result<(), FmuError> {
        let call: Symbol<unsafe extern "C" fn(Component, *const c_uint, usize, *mut f64, usize) -> c_int> =
            self.symbol("fmi3GetFloat64")?;
        let n = references.len().min(values.len());
        // SAFETY: both arrays hold n entries.
        check(&self.path, "fmi3GetFloat64", unsafe {
            call(self.component, references.as_ptr(), n, values.as_mut_ptr(), n)
        })
    }

    fn step(&mut self, time_s: f64, step_s: f64) -> Result<(), FmuError> {
        let call: Symbol<DoStep> = self.symbol("fmi3DoStep")?;
        let (mut event, mut terminate, mut early, mut last) = (false, false, false, 0.0);
        // SAFETY: signature by the standard, instance alive, the four results are ours.
        let status = unsafe {
            let results = (&raw mut event, &raw mut terminate, &raw mut early, &raw mut last);
            call(self.component, time_s, step_s, false, results.0, results.1, results.2, results.3)
        };
        check(&self.path, "fmi3DoStep", status)?;
        if terminate {
            return Err(FmuError::Refused {
                path: self.path.clone(),
                function: "fmi3DoStep",
                status: "the wish to end the simulation",
                hint: "",
            });
        }
        Ok(())
    }

    fn save(&self) -> Result<Vec<u8>, FmuError> {
        let mut state: *mut c_void = std::ptr::null_mut();
        let get: Symbol<unsafe extern "C" fn(Component, *mut *mut c_void) -> c_int> =
            self.symbol("fmi3GetFMUState")?;
        let size: Symbol<unsafe extern "C" fn(Component, *mut c_void, *mut usize) -> c_int> =
            self.symbol("fmi3SerializedFMUStateSize")?;
        let serialise: Symbol<unsafe extern "C" fn(Component, *mut c_void, *mut u8, usize) -> c_int> =
            self.symbol("fmi3SerializeFMUState")?;
        let release: Symbol<unsafe extern "C" fn(Component, *mut *mut c_void) -> c_int> =
            self.symbol("fmi3FreeFMUState")?;
        // SAFETY: signatures by the standard; the state is freed once, the buffer holds the size that the unit named.
        unsafe {
            check(&self.path, "fmi3GetFMUState", get(self.component, &raw mut state))?;
            let mut n = 0;
            let mut status = size(self.component, state, &raw mut n);
            let mut bytes = vec![0u8; if status <= 1 { n } else { 0 }];
            if status <= 1 {
                status = serialise(self.component, state, bytes.as_mut_ptr(), n);
            }
            release(self.component, &raw mut state);
            check(&self.path, "fmi3SerializeFMUState", status).map(|()| bytes)
        }
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), FmuError> {
        let mut state: *mut c_void = std::ptr::null_mut();
        let read: Symbol<unsafe extern "C" fn(Component, *const u8, usize, *mut *mut c_void) -> c_int> =
            self.symbol("fmi3DeserializeFMUState")?;
        let set: Symbol<unsafe extern "C" fn(Component, *mut c_void) -> c_int> =
            self.symbol("fmi3SetFMUState")?;
        let release: Symbol<unsafe extern "C" fn(Component, *mut *mut c_void) -> c_int> =
            self.symbol("fmi3FreeFMUState")?;
        // SAFETY: as in `save`.
        unsafe {
            let status = read(self.component, bytes.as_ptr(), bytes.len(), &raw mut state);
            check(&self.path, "fmi3DeserializeFMUState", status)?;
            let status = set(self.component, state);
            release(self.component, &raw mut state);
            check(&self.path, "fmi3SetFMUState", status)
        }
    }
}
