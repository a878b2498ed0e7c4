//! The domain of ROS 2 that the environment describes, and what of the environment cannot be heeded.

use rosbridge::{Domain, NodeError};

/// Distributions whose nodes are numbered with 24 bytes.
const LONG_GIDS: [&str; 5] = ["dashing", "eloquent", "foxy", "galactic", "humble"];
/// Middlewares that speak DDS.
const DDS: [&str; 4] = [
    "rmw_fastrtps",
    "rmw_cyclonedds",
    "rmw_connextdds",
    "rmw_gurumdds",
];

/// Where a node of ROS 2 is to be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) domain: Domain,
    /// What the operator should hear.
    pub(super) said: Option<String>,
}

/// The domain that the environment (`get`) describes, for a node that may (`network`) or may not be
/// reached by other machines.
///
/// # Errors
/// The environment asks for what there is not.
pub(super) fn place(
    network: bool,
    get: impl Fn(&str) -> Option<String>,
) -> Result<Place, NodeError> {
    let get = |name: &str| get(name).filter(|value| !value.is_empty());
    let refused = |reason: String| Err(NodeError::Wire { reason });
    let number = match get("ROS_DOMAIN_ID") {
        None => 0,
        Some(text) => match text.trim().parse() {
            Ok(number) => number,
            Err(_) => return refused(format!("ROS_DOMAIN_ID is `{text}`: expected 0 to 232")),
        },
    };
    if let Some(middleware) = get("RMW_IMPLEMENTATION")
        && !DDS.iter().any(|known| middleware.starts_with(known))
    {
        return refused(format!(
            "RMW_IMPLEMENTATION is {middleware}, which is no DDS: expected rmw_fastrtps_cpp, \
             rmw_cyclonedds_cpp or another that speaks DDS, here and on the other nodes"
        ));
    }
    if let Some(peers) = get("ROS_STATIC_PEERS") {
        return refused(format!(
            "ROS_STATIC_PEERS names {peers}, and named peers are not looked for: unset it; nodes are \
             found on this computer or, with ros.network = true, by multicast"
        ));
    }
    let range = get("ROS_AUTOMATIC_DISCOVERY_RANGE");
    let here_alone = get("ROS_LOCALHOST_ONLY").is_some_and(|value| value != "0");
    let range = if here_alone {
        Some("LOCALHOST".to_owned())
    } else {
        range
    };
    let mut said = None;
    match range.as_deref() {
        Some("LOCALHOST") if network => {
            return refused(
                "ros.network = true, but ROS_LOCALHOST_ONLY or ROS_AUTOMATIC_DISCOVERY_RANGE keeps \
                 nodes on this computer: change one of them"
                    .to_owned(),
            );
        }
        None | Some("LOCALHOST") => {}
        Some("SUBNET" | "SYSTEM_DEFAULT") if network => {}
        Some(range @ ("SUBNET" | "SYSTEM_DEFAULT")) => {
            said = Some(format!(
                "this node stays on the loopback interface, although \
                 ROS_AUTOMATIC_DISCOVERY_RANGE is {range}: ros.network = true opens it"
            ));
        }
        Some("OFF") => {
            return refused(
                "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF, and without discovery this node finds nobody: \
                 expected LOCALHOST"
                    .to_owned(),
            );
        }
        Some(other) => {
            return refused(format!(
                "ROS_AUTOMATIC_DISCOVERY_RANGE is `{other}`: expected LOCALHOST or SUBNET"
            ));
        }
    }
    let long_gids = get("ROS_DISTRO").is_some_and(|name| LONG_GIDS.contains(&name.as_str()));
    Ok(Place {
        domain: Domain { number, long_gids },
        said,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(network: bool, set: &[(&str, &str)]) -> Result<Place, String> {
        let find = |name: &str| {
            let found = set.iter().find(|(key, _)| *key == name);
            found.map(|(_, value)| (*value).to_owned())
        };
        place(network, find).map_err(|error| error.to_string())
    }

    #[test]
    fn the_environment_chooses_the_domain() {
        let plain = at(false, &[]).unwrap();
        assert_eq!((plain.domain, plain.said), (Domain::default(), None));
        let humble = at(
            false,
            &[
                ("ROS_DOMAIN_ID", "42"),
                ("ROS_DISTRO", "humble"),
                ("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"),
                ("ROS_LOCALHOST_ONLY", "1"),
            ],
        );
        let domain = humble.unwrap().domain;
        assert_eq!((domain.number, domain.long_gids), (42, true));
        let asked = at(false, &[("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")]);
        assert!(asked.unwrap().said.unwrap().contains("ros.network = true"));
        let open = at(true, &[("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")]);
        assert_eq!(open.unwrap().said, None);
    }

    #[test]
    fn what_cannot_be_heeded_is_refused_by_name() {
        for (network, name, value) in [
            (false, "ROS_DOMAIN_ID", "many"),
            (false, "RMW_IMPLEMENTATION", "rmw_zenoh_cpp"),
            (true, "ROS_STATIC_PEERS", "192.168.0.2"),
            (false, "ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF"),
            (false, "ROS_AUTOMATIC_DISCOVERY_RANGE", "FAR"),
            (true, "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
            (true, "ROS_LOCALHOST_ONLY", "1"),
        ] {
            let error = at(network, &[(name, value)]).unwrap_err();
            assert!(error.contains(name), "{error}");
        }
    }
}
