//! What a node says, on `/rosout` and on standard error, and the services that choose how much of it, as
//! ROS's own nodes have them: `~get_loggers` and `~set_logger_level` (package `roscpp`) on ROS 1,
//! `~get_logger_levels` and `~set_logger_levels` (package `rcl_interfaces`) on ROS 2.

use std::collections::VecDeque;
use std::io::Write;
use std::sync::{Arc, Mutex, OnceLock};

use super::{Node, NodeClock, NodeError, Outlet, Quality, Service, lock};
use crate::convert;
use crate::msg::rcl_interfaces::{
    GetLoggerLevels, GetLoggerLevelsRes, LoggerLevel, SetLoggerLevels, SetLoggerLevelsRes,
    SetLoggerLevelsResult,
};
use crate::msg::roscpp::{GetLoggers, GetLoggersRes, Logger, SetLoggerLevel, SetLoggerLevelRes};
use crate::msg::rosgraph_msgs::Log;

/// The one logger on ROS 1, named as `roscpp` names those of a package. On ROS 2 it has the node's name.
const LOGGER: &str = "ros.needle_steer";
/// Where a node speaks.
const TOPIC: &str = "/rosout";
/// Messages that wait for a first listener: `rosout` connects some time after a node has begun.
const KEPT: u16 = 64;

/// How much a message matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// For who looks for a mistake; not said unless asked for.
    Debug,
    /// The normal course.
    Info,
    /// Worth attention.
    Warning,
    /// A fault, or the reason of a stop.
    Error,
    /// The end of the program.
    Fatal,
}

impl Severity {
    const ALL: [Self; 5] = [
        Self::Debug,
        Self::Info,
        Self::Warning,
        Self::Error,
        Self::Fatal,
    ];

    /// The name of the level that `roscpp` knows.
    const fn name(self) -> &'static str {
        match self {
            Self::Debug => "debug",
            Self::Info => "info",
            Self::Warning => "warn",
            Self::Error => "error",
            Self::Fatal => "fatal",
        }
    }

    /// The level of a message.
    const fn level(self) -> i8 {
        match self {
            Self::Debug => Log::DEBUG,
            Self::Info => Log::INFO,
            Self::Warning => Log::WARN,
            Self::Error => Log::ERROR,
            Self::Fatal => Log::FATAL,
        }
    }

    /// The level of a logger of ROS 2.
    const fn number(self) -> u8 {
        match self {
            Self::Debug => LoggerLevel::LOG_LEVEL_DEBUG,
            Self::Info => LoggerLevel::LOG_LEVEL_INFO,
            Self::Warning => LoggerLevel::LOG_LEVEL_WARN,
            Self::Error => LoggerLevel::LOG_LEVEL_ERROR,
            Self::Fatal => LoggerLevel::LOG_LEVEL_FATAL,
        }
    }
}

/// The voice of a node.
pub(super) struct Speech {
    node: String,
    clock: NodeClock,
    least: Mutex<Severity>,
    unheard: Mutex<VecDeque<Log>>,
    topic: OnceLock<Outlet<Log>>,
}

impl Speech {
    /// Of the node of this full name; on standard error at once, on `/rosout` once it is
    /// [open](Self::open).
    pub(super) fn new(node: &str, clock: NodeClock) -> Self {
        Self {
            node: node.to_owned(),
            clock,
            least: Mutex::new(Severity::Info),
            unheard: Mutex::default(),
            topic: OnceLock::new(),
        }
    }

    /// Advertises `/rosout` and the services.
    pub(super) fn open(self: &Arc<Self>, node: &Node) -> Result<(), NodeError> {
        let is_ros1 = node.inner.carrier.is_ros1();
        let quality = if is_ros1 {
            Quality::Event(KEPT)
        } else {
            Quality::Latched(KEPT)
        };
        // Opened once.
        let _ = self.topic.set(Outlet::new(node, TOPIC, quality)?);
        let speech = Arc::clone(self);
        if !is_ros1 {
            Service::open::<GetLoggerLevels>(node, "~get_logger_levels", move |request| {
                Ok(speech.levels(&request.names))
            })?;
            let speech = Arc::clone(self);
            return Service::open::<SetLoggerLevels>(node, "~set_logger_levels", move |request| {
                Ok(speech.choose_levels(&request.levels))
            });
        }
        Service::open::<GetLoggers>(node, "~get_loggers", move |_| Ok(speech.loggers()))?;
        let speech = Arc::clone(self);
        Service::open::<SetLoggerLevel>(node, "~set_logger_level", move |request| {
            speech.choose(&request.logger, &request.level)
        })
    }

    /// Says something, unless it matters too little. Never waits for a listener.
    pub(super) fn say(&self, severity: Severity, text: &str) {
        if severity < *lock(&self.least) {
            return;
        }
        let label = severity.name().to_uppercase();
        // Nothing can be done about a closed stderr.
        let _ = writeln!(std::io::stderr(), "[{label}] {text}");
        let mut unheard = lock(&self.unheard);
        if unheard.len() == usize::from(KEPT) {
            unheard.pop_front();
        }
        unheard.push_back(Log {
            header: convert::header(self.clock.ros_stamp(self.clock.now()), "", 0),
            level: severity.level(),
            name: self.node.clone(),
            msg: text.to_owned(),
            ..Log::default()
        });
        drop(unheard);
        self.repeat();
    }

    /// Sends what nobody could hear yet, if somebody can now.
    pub(super) fn repeat(&self) {
        if let Some(topic) = self.topic.get()
            && (topic.keeps() || topic.subscribers() > 0)
        {
            let mut unheard = lock(&self.unheard);
            unheard.drain(..).for_each(|message| topic.send(message));
        }
    }

    fn loggers(&self) -> GetLoggersRes {
        GetLoggersRes {
            loggers: vec![Logger {
                name: LOGGER.to_owned(),
                level: lock(&self.least).name().to_owned(),
            }],
        }
    }

    fn choose(&self, logger: &str, level: &str) -> Result<SetLoggerLevelRes, String> {
        if logger != LOGGER {
            return Err(format!("no logger {logger}: there is {LOGGER}"));
        }
        let known = Severity::ALL.into_iter();
        let least = known
            .clone()
            .find(|severity| severity.name().eq_ignore_ascii_case(level));
        let Some(least) = least else {
            let names: Vec<_> = known.map(Severity::name).collect();
            return Err(format!("no level {level}: expected {}", names.join(", ")));
        };
        *lock(&self.least) = least;
        Ok(SetLoggerLevelRes {})
    }

    /// The logger's name on ROS 2: the node's, as `rclcpp` and `rclpy` make it of the full name.
    fn own_name(&self) -> String {
        self.node.trim_start_matches('/').replace('/', ".")
    }

    /// The levels of loggers of ROS 2, in their order; unknown ones have the level that says so.
    fn levels(&self, names: &[String]) -> GetLoggerLevelsRes {
        let own = self.own_name();
        let level = |name: &String| LoggerLevel {
            name: name.clone(),
            level: if *name == own {
                lock(&self.least).number().into()
            } else {
                LoggerLevel::LOG_LEVEL_UNKNOWN.into()
            },
        };
        GetLoggerLevelsRes {
            levels: names.iter().map(level).collect(),
        }
    }

    fn choose_levels(&self, levels: &[LoggerLevel]) -> SetLoggerLevelsRes {
        let result = |asked| {
            let refused = self.choose_level(asked).err();
            SetLoggerLevelsResult {
                successful: refused.is_none(),
                reason: refused.unwrap_or_default(),
            }
        };
        SetLoggerLevelsRes {
            results: levels.iter().map(result).collect(),
        }
    }

    fn choose_level(&self, asked: &LoggerLevel) -> Result<(), String> {
        let own = self.own_name();
        if asked.name != own {
            return Err(format!("no logger {}: there is {own}", asked.name));
        }
        let mut known = Severity::ALL.into_iter();
        let least = known.find(|severity| u32::from(severity.number()) == asked.level);
        let Some(least) = least else {
            let known = Severity::ALL.map(|severity| severity.number().to_string());
            let known = known.join(", ");
            return Err(format!("no level {}: expected {known}", asked.level));
        };
        *lock(&self.least) = least;
        Ok(())
    }
}
