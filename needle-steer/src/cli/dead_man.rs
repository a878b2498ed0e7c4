//! The dead-man's switch: a key held in the terminal, or tokens over ROS.

use std::io::Write;
use std::sync::Arc;

use super::Usage;
use crate::config::{Config, RosClock};
use crate::controls::Controls;
use crate::ros::Link;

/// What watches the operator; dropped, it gives the terminal back as it was.
#[derive(Debug)]
pub(super) struct Watch {
    #[cfg(unix)]
    _terminal: Option<terminal::Terminal>,
}

/// Lets a held key, and where there is a node its topic and service, refresh the token that
/// `config` asks for; nothing where it asks for none.
///
/// # Errors
/// Nothing can refresh it.
pub(super) fn watch(
    config: &Config,
    link: Option<&Link>,
    controls: &Arc<Controls>,
) -> anyhow::Result<Option<Watch>> {
    let longest = config.supervisor.dead_man_ms;
    if longest <= 0.0 || config.run.dry_run {
        return Ok(None);
    }
    if link.is_some() && config.ros.clock == RosClock::Simulated {
        return Err(Usage(format!(
            "supervisor.dead_man_ms = {longest}: nobody can hold a switch in simulated time; \
             it needs ros.clock = \"wall\""
        ))
        .into());
    }
    #[cfg(unix)]
    let terminal = terminal::Terminal::open(controls)?;
    #[cfg(unix)]
    let key = terminal.is_some();
    #[cfg(not(unix))]
    let key = false;
    let remote = config.is_watched();
    let how = match (key, link) {
        (_, None) if remote => {
            "send DEAD_MAN over OpenIGTLink or call the live view's service, or hold any key"
        }
        (false, None) => {
            return Err(Usage(format!(
                "supervisor.dead_man_ms = {longest}: nothing can refresh the dead-man's switch: \
                 there is no terminal to hold a key in, no ROS node (ros.publish = true) and no \
                 server (igtl.serve, live.serve); 0 asks for none"
            ))
            .into());
        }
        (true, None) => "hold any key (space, say)",
        (false, Some(_)) => "publish on ~dead_man (std_msgs/Empty) or call that service",
        (true, Some(_)) => "hold any key, or publish on ~dead_man (std_msgs/Empty)",
    };
    if let Some(link) = link {
        link.listen_to_dead_man(controls)?;
    }
    writeln!(
        std::io::stderr(),
        "dead-man's switch: {how}; the arm moves only while that goes on, {longest} ms at most \
         between two times"
    )?;
    Ok(Some(Watch {
        #[cfg(unix)]
        _terminal: terminal,
    }))
}

#[cfg(unix)]
mod terminal {
    use std::io::{ErrorKind, IsTerminal, Read, stdin};
    use std::sync::Arc;

    use anyhow::Context;
    use rustix::process::getpgrp;
    use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcgetpgrp, tcsetattr};

    use crate::controls::Controls;

    /// A terminal whose keys arrive one by one and are not shown; Ctrl-C stays what it is.
    #[derive(Debug)]
    pub(super) struct Terminal {
        before: Termios,
    }

    impl Terminal {
        /// Reads standard input where that is a terminal and this program's to read: every key
        /// refreshes the token.
        pub(super) fn open(controls: &Arc<Controls>) -> anyhow::Result<Option<Self>> {
            let input = stdin();
            let background = || tcgetpgrp(&input).is_ok_and(|group| group != getpgrp());
            if !input.is_terminal() || background() {
                return Ok(None);
            }
            let before = tcgetattr(&input).context("reading the terminal's settings")?;
            let mut keys = before.clone();
            keys.local_modes
                .remove(LocalModes::ICANON | LocalModes::ECHO);
            // What was typed before is no sign of life.
            tcsetattr(&input, OptionalActions::Flush, &keys).context("setting the terminal")?;
            let terminal = Self { before };
            let controls = Arc::clone(controls);
            std::thread::Builder::new()
                .name("dead-man".to_owned())
                .spawn(move || read(&controls))
                .context("a thread for the terminal")?;
            Ok(Some(terminal))
        }
    }

    /// Ends with the terminal; blocks between keys.
    fn read(controls: &Controls) {
        let mut keys = [0; 64];
        loop {
            match stdin().lock().read(&mut keys) {
                Ok(0) => return,
                Ok(_) => controls.refresh_dead_man(),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return,
            }
        }
    }

    impl Drop for Terminal {
        fn drop(&mut self) {
            // A terminal that is gone needs no settings.
            let _ = tcsetattr(stdin(), OptionalActions::Flush, &self.before);
        }
    }
}
