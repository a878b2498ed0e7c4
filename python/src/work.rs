//! Long work: the interpreter is let go of, Ctrl-C is heard, and a panic becomes an exception.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use needle_steer::controls::Controls;
use pyo3::prelude::*;

use crate::errors::{InternalError, failed};

/// How often signals are looked for.
const LOOK: Duration = Duration::from_millis(50);
/// Stack of the working thread, as a main thread has it \[bytes\].
const STACK: usize = 8 << 20;

/// Does `work` on another thread, without the interpreter. Ctrl-C interrupts `controls`, waits for
/// the work's end and is raised.
///
/// # Errors
/// The signal's exception; [`InternalError`] for a panic.
#[expect(
    clippy::redundant_closure_for_method_calls,
    reason = "the method alone has one lifetime, the closure all"
)]
pub(crate) fn interruptible<T: Send>(
    py: Python<'_>,
    controls: &Controls,
    work: impl FnOnce() -> T + Send,
) -> PyResult<T> {
    let (joined, signal) = py.detach(|| {
        std::thread::scope(|scope| {
            let (done, wait) = channel();
            let worker = std::thread::Builder::new()
                .name("needle-steer".into())
                .stack_size(STACK)
                .spawn_scoped(scope, move || {
                    // Attached once, so that callbacks on this thread are cheap.
                    let result =
                        Python::attach(|py| py.detach(|| catch_unwind(AssertUnwindSafe(work))));
                    // Whoever waits no more needs no telling.
                    let _ = done.send(());
                    result
                });
            let worker = match worker {
                Ok(worker) => worker,
                Err(error) => return (Err(failed(error)), None),
            };
            let mut signal = None;
            while wait.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
                if signal.is_none()
                    && let Err(raised) = Python::attach(|py| py.check_signals())
                {
                    controls.interrupt();
                    signal = Some(raised);
                }
            }
            let result = worker.join().and_then(|result| result);
            (result.map_err(|panic| named(panic.as_ref())), signal)
        })
    });
    match signal {
        Some(raised) => Err(raised),
        None => joined,
    }
}

/// Work of some moments without the interpreter: a panic becomes an exception.
///
/// # Errors
/// [`InternalError`] for a panic.
pub(crate) fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    py.detach(|| catch_unwind(AssertUnwindSafe(work)).map_err(|panic| named(panic.as_ref())))
}

/// Short work with the interpreter held: a panic becomes an exception.
///
/// # Errors
/// [`InternalError`] for a panic; the work's own.
pub(crate) fn guarded<T>(work: impl FnOnce() -> PyResult<T>) -> PyResult<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| Err(named(panic.as_ref())))
}

fn named(panic: &(dyn Any + Send)) -> PyErr {
    let words = panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message");
    InternalError::new_err(format!("internal fault: {words}"))
}

/// Where a callback leaves the exception that it raised; the run then stops the arm and ends.
#[derive(Clone, Default)]
pub(crate) struct Failure {
    pub(crate) controls: Arc<Controls>,
    raised: Arc<Mutex<Option<PyErr>>>,
}

impl Failure {
    /// Keeps the first exception and stops the run.
    pub(crate) fn note(&self, error: PyErr) {
        self.raised
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get_or_insert(error);
        self.controls.stop();
    }

    /// The exception, if there was one.
    pub(crate) fn take(&self) -> Option<PyErr> {
        self.raised
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
    }
}

/// Panics, for the test that says what becomes of panics.
#[pyfunction]
#[expect(clippy::panic, reason = "this is its purpose")]
pub(crate) fn panic_on_purpose(py: Python<'_>, long: bool) -> PyResult<()> {
    let words = "asked for by a test";
    if long {
        interruptible(py, &Controls::default(), || panic!("{words}"))
    } else {
        guarded(|| panic!("{words}"))
    }
}
