//! Stamps, latency, drops and pooled buffers.

use std::collections::BTreeSet;
use std::sync::Arc;

use hal::{Stamp, StereoCamera};

use super::scene::{needle, rig};
use crate::camera::CameraSettings;

fn small() -> CameraSettings {
    CameraSettings {
        width_px: 64,
        height_px: 48,
        focal_px: 200.0,
        ..CameraSettings::ideal()
    }
}

#[test]
fn pairs_arrive_in_order_after_their_latency() {
    let mut settings = small();
    settings.delivery.latency_min_ms = 30.0;
    settings.delivery.latency_max_ms = 60.0;
    let mut rig = rig(&settings, 3);
    let shown = needle(0.05, 0.0, 0.0, 0.0);
    let mut latencies = Vec::new();
    let mut last = None;
    for step in 0..6000_u64 {
        let now = Stamp::from_nanos(step * 1_000_000);
        while rig.next_exposure() <= now {
            rig.expose(&shown);
        }
        rig.advance_to(now);
        while let Some(pair) = rig.poll().unwrap() {
            let stamp = Stamp::from_secs(pair.left.sequence as f64 / 30.0);
            assert_eq!((pair.left.stamp, pair.right.stamp), (stamp, stamp));
            assert_eq!(pair.left.sequence, pair.right.sequence);
            assert!(last.is_none_or(|l| pair.left.sequence > l));
            last = Some(pair.left.sequence);
            latencies.push(now.secs_since(stamp));
        }
    }
    // Looked at every millisecond.
    assert!(latencies.iter().all(|l| (0.0299..0.0611).contains(l)));
    let mean = latencies.iter().sum::<f64>() / latencies.len() as f64;
    assert!((mean - 0.0455).abs() < 0.003, "{mean}");
    assert!(latencies.len() > 170);
}

#[test]
fn poll_gives_the_newest_and_gaps_tell_of_drops() {
    let mut settings = small();
    settings.delivery.drop_probability = 0.3;
    let mut rig = rig(&settings, 3);
    let shown = needle(0.05, 0.0, 0.0, 0.0);
    let mut arrived = BTreeSet::new();
    for _ in 0..3000 {
        let stamp = rig.next_exposure();
        rig.expose(&shown);
        rig.advance_to(stamp);
        arrived.extend(rig.poll().unwrap().map(|pair| pair.left.sequence));
    }
    let dropped = 1.0 - arrived.len() as f64 / 3000.0;
    // Three sigma of a binomial of 3000.
    assert!((dropped - 0.3).abs() < 0.025, "{dropped}");
    for _ in 0..30 {
        rig.expose(&shown);
    }
    rig.advance_to(rig.next_exposure());
    let newest = rig.poll().unwrap().unwrap().left.sequence;
    assert!(newest > 3015);
    assert_eq!(rig.poll().unwrap(), None);
}

#[test]
fn buffers_are_reused_and_never_while_held() {
    let mut rig = rig(&small(), 1);
    let shown = needle(0.05, 0.0, 0.0, 0.0);
    let held = rig.render(&shown, 0);
    let copy = held.clone().map(|image| image.as_ref().clone());
    let mut seen = BTreeSet::new();
    for sequence in 1..50 {
        for image in rig.render(&needle(0.001 * sequence as f64, 0.0, 0.0, 0.0), sequence) {
            seen.insert(Arc::as_ptr(&image) as usize);
        }
    }
    assert_eq!(seen.len(), 2, "images allocated");
    assert_eq!(held.map(|image| image.as_ref().clone()), copy);
}
