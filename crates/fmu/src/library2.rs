//! FMI 2.0 through its C interface.

use std::ffi::{CString, c_char, c_int, c_uint, c_void};
use std::path::Path;

use libloading::{Library, Symbol};

use crate::description::Description;
use crate::error::FmuError;
use crate::library::{Instance, check, load, unlinked};

type Component = *mut c_void;
type Instantiate = unsafe extern "C" fn(
    *const c_char,
    c_int,
    *const c_char,
    *const c_char,
    *const Callbacks,
    c_int,
    c_int,
) -> Component;

/// `fmi2CallbackFunctions`. The unit may keep the pointer, so that the table lives as long as the instance.
#[repr(C)]
struct Callbacks {
    logger: unsafe extern "C" fn(),
    allocate: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free: unsafe extern "C" fn(*mut c_void),
    finished: *const c_void,
    environment: *mut c_void,
}

unsafe extern "C" {
    fn calloc(n: usize, size: usize) -> *mut c_void;
    fn free(p: *mut c_void);
}

/// Messages of a unit are not shown: its status codes say what matters. (It is variadic in C; arguments are the
/// caller's to clean up, so that taking none is sound.)
unsafe extern "C" fn silent() {}

pub(crate) struct Unit2 {
    path: String,
    library: Library,
    component: Component,
    /// Held for the instance, never read by us.
    _callbacks: Box<Callbacks>,
}

// SAFETY: the instance is only ever reached through `&mut self` or `&self` of one owner, and FMI asks for no thread.
unsafe impl Send for Unit2 {}

impl Unit2 {
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
        let callbacks = Box::new(Callbacks {
            logger: silent,
            allocate: calloc,
            free,
            finished: std::ptr::null(),
            environment: std::ptr::null_mut(),
        });
        // SAFETY: the symbol has this signature by the standard; all pointers live beyond the call.
        let component = unsafe {
            let call: Symbol<Instantiate> =
                library.get(b"fmi2Instantiate\0").map_err(|e| unlinked(path, &e))?;
            call(name.as_ptr(), 1, token.as_ptr(), resources.as_ptr(), &raw const *callbacks, 0, 0)
        };
        if component.is_null() {
            return Err(fail(
                "fmi2Instantiate gave no instance: does the guid of the description fit the binary?".into(),
            ));
        }
        Ok(Self { path: path.into(), library, component, _callbacks: callbacks })
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

impl Drop for Unit2 {
    fn drop(&mut self) {
        if let Ok(call) = self.symbol::<unsafe extern "C" fn(Component)>("fmi2FreeInstance") {
            // SAFETY: the instance came from fmi2Instantiate and is freed once.
            unsafe { call(self.component) };
        }
    }
}

impl Instance for Unit2 {
    fn start(&mut self, parameters: &[(u32, f64)]) -> Result<(), FmuError> {
        self.plain("fmi2Reset")?;
        let (references, values): (Vec<u32>, Vec<f64>) = parameters.iter().copied().unzip();
        self.set(&references, &values)?;
        {
            let call: Symbol<unsafe extern "C" fn(Component, c_int, f64, f64, c_int, f64) -> c_int> =
                self.symbol("fmi2SetupExperiment")?;
            // SAFETY: signature by the standard, instance alive.
            check(&self.path, "fmi2SetupExperiment", unsafe { call(self.component, 0, 0.0, 0.0, 0, 0.0) })?;
        }
        self.plain("fmi2EnterInitializationMode")?;
        self.plain("fmi2ExitInitializationMode")
    }

    fn set(&mut self, references: &[u32], values: &[f64]) -> Result<(), FmuError> {
        if references.is_empty() {
            return Ok(());
        }
        let call: Symbol<unsafe extern "C" fn(Component, *const c_uint, usize, *const f64) -> c_int> =
            self.symbol("fmi2SetReal")?;
        let n = references.len().min(values.len());
        // SAFETY: both arrays hold n entries.
        check(&self.path, "fmi2SetReal", unsafe {
            call(self.component, references.as_ptr(), n, values.as_ptr())
        })
    }

    fn get(&self, references: &[u32], values: &mut [f64]) -> Result<(), FmuError> {
        let call: Symbol<unsafe extern "C" fn(Component, *const c_uint, usize, *mut f64) -> c_int> =
            self.symbol("fmi2GetReal")?;
        let n = references.len().min(values.len());
        // SAFETY: both arrays hold n entries.
        check(&self.path, "fmi2GetReal", unsafe {
            call(self.component, references.as_ptr(), n, values.as_mut_ptr())
        })
    }

    fn step(&mut self, time_s: f64, step_s: f64) -> Result<(), FmuError> {
        let call: Symbol<unsafe extern "C" fn(Component, f64, f64, c_int) -> c_int> =
            self.symbol("fmi2DoStep")?;
        // SAFETY: signature by the standard, instance alive.
        check(&self.path, "fmi2DoStep", unsafe { call(self.component, time_s, step_s, 0) })
    }

    fn save(&self) -> Result<Vec<u8>, FmuError> {
        let mut state: *mut c_void = std::ptr::null_mut();
        let get: Symbol<unsafe extern "C" fn(Component, *mut *mut c_void) -> c_int> =
            self.symbol("fmi2GetFMUstate")?;
        let size: Symbol<unsafe extern "C" fn(Component, *mut c_void, *mut usize) -> c_int> =
            self.symbol("fmi2SerializedFMUstateSize")?;
        let serialise: Symbol<unsafe extern "C" fn(Component, *mut c_void, *mut u8, usize) -> c_int> =
            self.symbol("fmi2SerializeFMUstate")?;
        let release: Symbol<unsafe extern "C" fn(Component, *mut *mut c_void) -> c_int> =
            self.symbol("fmi2FreeFMUstate")?;
        // SAFETY: signatures by the standard; the state is freed once, the buffer holds the size that the unit named.
        unsafe {
            check(&self.path, "fmi2GetFMUstate", get(self.component, &raw mut state))?;
            let mut n = 0;
            let mut status = size(self.component, state, &raw mut n);
            let mut bytes = vec![0u8; if status <= 1 { n } else { 0 }];
            if status <= 1 {
                status = serialise(self.component, state, bytes.as_mut_ptr(), n);
            }
            release(self.component, &raw mut state);
            check(&self.path, "fmi2SerializeFMUstate", status).map(|()| bytes)
        }
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), FmuError> {
        let mut state: *mut c_void = std::ptr::null_mut();
        let read: Symbol<unsafe extern "C" fn(Component, *const u8, usize, *mut *mut c_void) -> c_int> =
            self.symbol("fmi2DeSerializeFMUstate")?;
        let set: Symbol<unsafe extern "C" fn(Component, *mut c_void) -> c_int> =
            self.symbol("fmi2SetFMUstate")?;
        let release: Symbol<unsafe extern "C" fn(Component, *mut *mut c_void) -> c_int> =
            self.symbol("fmi2FreeFMUstate")?;
        // SAFETY: as in `save`.
        unsafe {
            let status = read(self.component, bytes.as_ptr(), bytes.len(), &raw mut state);
            check(&self.path, "fmi2DeSerializeFMUstate", status)?;
            let status = set(self.component, state);
            release(self.component, &raw mut state);
            check(&self.path, "fmi2SetFMUstate", status)
        }
    }
}
