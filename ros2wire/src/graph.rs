//! Which nodes there are: the topic `ros_discovery_info` (`rmw_dds_common/msg/ParticipantEntitiesInfo`),
//! by which ROS 2's tools know a participant's nodes.

use std::collections::HashMap;

/// Most nodes and endpoints that are read of one participant.
const MOST: usize = 4096;

/// A participant's or endpoint's number.
pub(crate) type Guid = [u8; 16];

/// How long such a number is on this topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Gids {
    /// 16 bytes: from Iron on.
    #[default]
    Short,
    /// 24 bytes, the last eight zero: up to Humble.
    Long,
}

impl Gids {
    const fn length(self) -> usize {
        match self {
            Self::Short => 16,
            Self::Long => 24,
        }
    }
}

/// Nodes and what belongs to them.
#[derive(Debug, Default)]
pub(crate) struct Graph {
    /// Full names of nodes by the first twelve bytes of their participant's number; the first where a
    /// participant has several.
    names: HashMap<[u8; 12], String>,
}

impl Graph {
    /// Takes in what another participant says of itself.
    pub(crate) fn hear(&mut self, payload: &[u8]) {
        let read = [Gids::Short, Gids::Long]
            .iter()
            .find_map(|&gids| read(payload, gids));
        if let Some((participant, nodes)) = read {
            let prefix = prefix(&participant);
            match nodes.into_iter().next() {
                Some(name) if self.names.len() < MOST => {
                    self.names.insert(prefix, name);
                }
                Some(_) => {}
                None => {
                    self.names.remove(&prefix);
                }
            }
        }
    }

    /// The node to which an endpoint belongs.
    pub(crate) fn node(&self, endpoint: &Guid) -> Option<&str> {
        self.names.get(&prefix(endpoint)).map(String::as_str)
    }
}

/// The part of a number that a participant's all have in common.
pub(crate) fn prefix(guid: &Guid) -> [u8; 12] {
    let mut prefix = [0; 12];
    prefix.copy_from_slice(&guid[..12]);
    prefix
}

/// What this participant says of itself.
#[derive(Clone, Debug)]
pub(crate) struct Own {
    pub(crate) gids: Gids,
    pub(crate) participant: Guid,
    pub(crate) namespace: String,
    pub(crate) node: String,
    pub(crate) readers: Vec<Guid>,
    pub(crate) writers: Vec<Guid>,
}

impl Own {
    /// The message in CDR.
    pub(crate) fn payload(&self) -> Vec<u8> {
        let mut out = Vec::new();
        self.gid(&mut out, &self.participant);
        count(&mut out, 1);
        for text in [&self.namespace, &self.node] {
            count(&mut out, text.len() + 1);
            out.extend_from_slice(text.as_bytes());
            out.push(0);
        }
        for endpoints in [&self.readers, &self.writers] {
            count(&mut out, endpoints.len());
            for endpoint in endpoints {
                self.gid(&mut out, endpoint);
            }
        }
        out
    }

    fn gid(&self, out: &mut Vec<u8>, guid: &Guid) {
        let end = out.len() + self.gids.length();
        out.extend_from_slice(guid);
        out.resize(end, 0);
    }
}

fn align(out: &mut Vec<u8>) {
    out.resize(out.len().next_multiple_of(4), 0);
}

fn count(out: &mut Vec<u8>, value: usize) {
    align(out);
    out.extend_from_slice(&u32::try_from(value).unwrap_or(u32::MAX).to_le_bytes());
}

/// The participant's number and its nodes' full names; nothing where that is no such message.
fn read(payload: &[u8], gids: Gids) -> Option<(Guid, Vec<String>)> {
    let mut at = Cursor { payload, place: 0 };
    let participant = at.take(gids.length())?.first_chunk::<16>().copied()?;
    let nodes = at.count()?;
    let mut names = Vec::new();
    for _ in 0..nodes {
        let (namespace, node) = (at.text()?, at.text()?);
        for _ in 0..2 {
            let endpoints = at.count()?;
            at.take(endpoints.checked_mul(gids.length())?)?;
        }
        let namespace = namespace.trim_end_matches('/');
        names.push(format!("{namespace}/{node}"));
    }
    (payload.len() - at.place < 4).then_some((participant, names))
}

struct Cursor<'a> {
    payload: &'a [u8],
    place: usize,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let end = self.place.checked_add(length)?;
        let taken = self.payload.get(self.place..end)?;
        self.place = end;
        Some(taken)
    }

    fn count(&mut self) -> Option<usize> {
        self.place = self.place.next_multiple_of(4);
        let count = u32::from_le_bytes(*self.take(4)?.first_chunk()?);
        usize::try_from(count).ok().filter(|&count| count <= MOST)
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = self.count()?;
        let bytes = self.take(length)?.split_last()?.1;
        std::str::from_utf8(bytes).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_participant_says_is_read_by_another_in_both_forms() {
        for gids in [Gids::Short, Gids::Long] {
            let mut own = Own {
                gids,
                participant: [7; 16],
                namespace: "/lab".into(),
                node: "arm".into(),
                readers: vec![[7; 16], [8; 16]],
                writers: vec![[9; 16]],
            };
            let mut graph = Graph::default();
            graph.hear(&own.payload());
            assert_eq!(graph.node(&[7; 16]), Some("/lab/arm"), "{gids:?}");
            assert_eq!(graph.node(&[6; 16]), None);
            own.namespace = "/".into();
            graph.hear(&own.payload());
            assert_eq!(graph.node(&[7; 16]), Some("/arm"), "{gids:?}");
            for length in 0..own.payload().len() - 3 {
                Graph::default().hear(&own.payload()[..length]);
            }
        }
    }
}
