//! Options of a run that other programs serve, watch or command: each may have an address behind `=`.

use clap::{Arg, ArgMatches, Args, Command, FromArgMatches};

use crate::config;

/// The options and what they are for.
const OPTIONS: [(&str, &str); 3] = [
    (
        "igtl",
        "Serve the run over OpenIGTLink: for 3D Slicer, PLUS; at this address and port, or the \
         configuration's (igtl.address)",
    ),
    (
        "live",
        "Serve a live view for Foxglove or Lichtblick; at this address and port, or the configuration's \
         (live.address)",
    ),
    (
        TRACKER,
        "The tip as a tracker over OpenIGTLink measures it (the sensor em): of a server at this address \
         and port, PLUS's for one; else of a program that connects to the run (--igtl)",
    ),
];
/// The option that reads instead of serving.
const TRACKER: &str = "tracker";

/// What was given: the option, and its address or nothing.
#[derive(Clone, Debug, Default)]
pub(super) struct Served(Vec<(&'static str, String)>);

impl Served {
    /// What the options change in the configuration.
    pub(super) fn overrides(&self) -> Vec<String> {
        let mut overrides = Vec::new();
        for (option, address) in &self.0 {
            let quoted = config::quoted(address);
            let set: &[String] = &match (*option, address.is_empty()) {
                (TRACKER, true) => ["run.sensor=em", "tracker.source=clients", "igtl.serve=true"]
                    .map(String::from)
                    .to_vec(),
                (TRACKER, false) => vec![
                    "run.sensor=em".to_owned(),
                    "tracker.source=server".to_owned(),
                    format!("tracker.address={quoted}"),
                ],
                (table, true) => vec![format!("{table}.serve=true")],
                (table, false) => vec![
                    format!("{table}.serve=true"),
                    format!("{table}.address={quoted}"),
                ],
            };
            overrides.extend_from_slice(set);
        }
        overrides
    }
}

impl FromArgMatches for Served {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut served = Self::default();
        served.update_from_arg_matches(matches)?;
        Ok(served)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.0 = OPTIONS
            .iter()
            .filter_map(|(name, _)| Some((*name, matches.get_one::<String>(name)?.clone())))
            .collect();
        Ok(())
    }
}

impl Args for Served {
    fn augment_args(command: Command) -> Command {
        OPTIONS.iter().fold(command, |command, (name, help)| {
            command.arg(
                Arg::new(*name)
                    .long(*name)
                    .help(*help)
                    .value_name("ADDRESS")
                    .num_args(0..=1)
                    .require_equals(true)
                    .default_missing_value(""),
            )
        })
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}
