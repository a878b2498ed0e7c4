//! The tracker allocates nothing once it follows the needle. A binary of its own: the allocator
//! counts for the whole program, and other tests would allocate beside it.
#![expect(unsafe_code, reason = "an allocator that counts")]
#![expect(clippy::unwrap_used, reason = "a failed step is a failed test")]

#[path = "needle_pictures/mod.rs"]
mod needle_pictures;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use needle_pictures::film::Film;

struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: everything is handed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as the caller warrants.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller warrants.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as the caller warrants.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations that `work` makes.
fn counted(mut work: impl FnMut()) -> usize {
    let before = ALLOCATIONS.load(Ordering::Relaxed);
    work();
    ALLOCATIONS.load(Ordering::Relaxed) - before
}

/// One test, because tests run beside each other.
#[test]
fn nothing_is_allocated_while_the_needle_is_followed() {
    assert!(counted(|| drop(std::hint::black_box(Box::new(1)))) == 1);
    let mut film = Film::new(640);
    let mut image = film.image_tracker();
    film.follow(&mut image).unwrap();
    let made = counted(|| {
        for _ in 0..60 {
            film.follow(&mut image).unwrap();
        }
    });
    assert_eq!(made, 0, "one image");
    let error = (image.curve().unwrap().tip() - film.tip_px().coords).norm();
    assert!(error < 1.0, "{error} px: the needle was not followed");

    let mut film = Film::new(640);
    let mut stereo = film.stereo_tracker();
    film.track(&mut stereo);
    let made = counted(|| {
        for _ in 0..60 {
            film.track(&mut stereo);
        }
    });
    assert_eq!(made, 0, "a pair with its curve in space");
    let error = film.error(&stereo);
    assert!(error < 0.1e-3, "{error} m: the needle was not followed");
}
