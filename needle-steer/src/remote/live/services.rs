//! What may be asked over the live view: services in JSON.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;

use foxglove::Schema;
use foxglove::websocket::service::{Service, ServiceSchema};
use hal::frame::{Frame, LeftCamera, World};
use hal::request::{Command, Request};
use hal::{Position, Transform};
use nalgebra::Point3;
use serde::Deserialize;
use serde_json::json;

use super::super::Post;
use crate::controls::Controls;

/// Longest wait of a caller for the run's verdict: as over ROS.
const ANSWER_DEADLINE: Duration = Duration::from_secs(1);
/// Encoding of requests and responses.
const JSON: &str = "json";

/// Services without arguments, named as ROS's.
const TRIGGERS: [(&str, Command); 7] = [
    ("/needle_steer/start", Command::Start),
    ("/needle_steer/resume", Command::Start),
    ("/needle_steer/pause", Command::Pause),
    ("/needle_steer/retract", Command::Retract),
    ("/needle_steer/stop", Command::Stop),
    ("/needle_steer/home", Command::Home),
    ("/needle_steer/clear_fault", Command::ClearFault),
];

/// A point and the frame in which it is given, which is World where none is named \[m\].
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Target {
    x: f64,
    y: f64,
    z: f64,
    #[serde(default)]
    frame_id: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Enable {
    data: bool,
}

/// Everything that a run may be asked for.
pub(super) fn all(
    post: &Post,
    controls: &Arc<Controls>,
    world_from_left_camera: Transform<World, LeftCamera>,
) -> Vec<Service> {
    let mut services: Vec<Service> = TRIGGERS
        .into_iter()
        .map(|(name, command)| {
            let post = post.clone();
            service(name, "Trigger", json!({}), move |_| ask(&post, command))
        })
        .collect();
    let enabling = post.clone();
    let properties = json!({ "data": { "type": "boolean" } });
    services.push(service(
        "/needle_steer/enable",
        "SetBool",
        properties,
        move |payload| {
            let Enable { data } = parse(payload)?;
            ask(&enabling, Command::Enable(data))
        },
    ));
    let aiming = post.clone();
    let number = json!({ "type": "number" });
    let properties =
        json!({ "x": number, "y": number, "z": number, "frame_id": { "type": "string" } });
    services.push(service(
        "/needle_steer/target",
        "Target",
        properties,
        move |payload| {
            let target = target(&parse(payload)?, &world_from_left_camera)?;
            ask(&aiming, Command::Target(target))
        },
    ));
    let controls = Arc::clone(controls);
    services.push(service(
        "/needle_steer/dead_man",
        "Trigger",
        json!({}),
        move |_| {
            controls.refresh_dead_man();
            Ok("refreshed".to_owned())
        },
    ));
    services
}

/// One service; its answer is `{"success": ..., "message": ...}`.
fn service(
    name: &str,
    kind: &str,
    properties: serde_json::Value,
    call: impl Fn(&[u8]) -> Result<String, String> + Send + Sync + 'static,
) -> Service {
    let schema = |name: String, properties: serde_json::Value| {
        let schema = json!({ "type": "object", "properties": properties });
        Schema::new(name, "jsonschema", schema.to_string().into_bytes())
    };
    let answer = json!({ "success": { "type": "boolean" }, "message": { "type": "string" } });
    let description = ServiceSchema::new(format!("needle_steer/{kind}"))
        .with_request(
            JSON,
            schema(format!("needle_steer/{kind}Request"), properties),
        )
        .with_response(JSON, schema(format!("needle_steer/{kind}Response"), answer));
    Service::builder(name, description).blocking_handler_fn(move |request| {
        let (success, message) = match call(request.payload()) {
            Ok(text) => (true, text),
            Err(reason) => (false, reason),
        };
        let answer = json!({ "success": success, "message": message });
        Ok::<_, String>(answer.to_string().into_bytes())
    })
}

fn parse<'a, T: Deserialize<'a>>(payload: &'a [u8]) -> Result<T, String> {
    serde_json::from_slice(payload).map_err(|error| format!("the request is no such JSON: {error}"))
}

/// A target in the stereo frame.
fn target(
    target: &Target,
    world_from_left_camera: &Transform<World, LeftCamera>,
) -> Result<Position<LeftCamera>, String> {
    let point = Point3::new(target.x, target.y, target.z);
    if !point.iter().all(|x| x.is_finite()) {
        return Err("target refused: a coordinate is not a number".to_owned());
    }
    match target.frame_id.as_deref() {
        None | Some("" | World::NAME) => {
            Ok(world_from_left_camera.inverse() * Position::new(point))
        }
        Some(LeftCamera::NAME) => Ok(Position::new(point)),
        Some(other) => Err(format!(
            "target refused: frame `{other}`, expected {} or {}",
            World::NAME,
            LeftCamera::NAME
        )),
    }
}

/// Hands a request over and waits for the verdict, on a thread that may wait.
fn ask(post: &Post, command: Command) -> Result<String, String> {
    let (answer, verdict) = sync_channel(1);
    post.send(Request::new(command, move |verdict| {
        // The caller may have gone.
        let _ = answer.try_send(verdict);
    }));
    verdict
        .recv_timeout(ANSWER_DEADLINE)
        .unwrap_or_else(|_| Err("no answer within a second".to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;

    #[test]
    fn targets_are_taken_in_both_frames_and_refused_elsewhere() {
        let pose: Transform<World, LeftCamera> =
            Transform::assume(Isometry3::translation(0.0, 0.0, 1.0));
        let told = |text: &str| target(&parse(text.as_bytes())?, &pose).map(|t| t.coords().z);
        assert_eq!(told(r#"{"x": 0, "y": 0, "z": 1.5}"#), Ok(0.5));
        let camera = format!(
            r#"{{"x": 0, "y": 0, "z": 1.5, "frame_id": "{}"}}"#,
            LeftCamera::NAME
        );
        assert_eq!(told(&camera), Ok(1.5));
        for bad in [
            "",
            "{}",
            "[1, 2]",
            r#"{"x": 0, "y": 0, "z": "deep"}"#,
            r#"{"x": 0, "y": 0, "z": 1e999}"#,
            r#"{"x": 0, "y": 0, "z": 1, "frame_id": "tool0"}"#,
            r#"{"x": 0, "y": 0, "z": 1, "frame": "world"}"#,
        ] {
            assert!(told(bad).is_err(), "{bad}");
        }
    }
}
