//! Growing a labelled grid from crossings.
//!
//! Two crossings are neighbours when each is the nearest along a ray of the other and both see
//! the same colour on the same side of the edge between them.

use nalgebra::Point2;

use super::saddle::Saddle;

/// A connected set of crossings with integer labels.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    /// Columns of the labels' bounding box.
    pub cols: usize,
    /// Rows of the labels' bounding box.
    pub rows: usize,
    /// Row-major; `None` where no crossing was found.
    pub cells: Vec<Option<Cell>>,
}

/// A labelled crossing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    /// Where it is \[px\].
    pub at: Point2<f64>,
    /// Whether the square towards growing column and row is dark.
    pub dark: bool,
}

impl Grid {
    /// Number of crossings.
    pub(super) fn count(&self) -> usize {
        self.cells.iter().flatten().count()
    }

    /// Mean of its crossings \[px\].
    pub(super) fn centre(&self) -> Point2<f64> {
        let all = self.cells.iter().flatten();
        let sum = all.fold(nalgebra::Vector2::zeros(), |s, c| s + c.at.coords);
        Point2::from(sum / self.count().max(1) as f64)
    }

    /// Distance of the first two crossings of a row \[px\].
    pub(super) fn spacing(&self) -> f64 {
        let first = self.cells.iter().flatten();
        let mut pair = first.take(2).map(|c| c.at);
        match (pair.next(), pair.next()) {
            (Some(a), Some(b)) => (a - b).norm(),
            _ => 0.0,
        }
    }

    /// The same labels with every crossing moved.
    pub(super) fn moved(&self, to: impl Fn(&Point2<f64>) -> Point2<f64>) -> Self {
        let mut grid = self.clone();
        for cell in grid.cells.iter_mut().flatten() {
            cell.at = to(&cell.at);
        }
        grid
    }

    /// The crossing at a column and row.
    pub(super) fn at(&self, col: usize, row: usize) -> Option<&Cell> {
        self.cells[row * self.cols + col].as_ref()
    }

    /// Drops outer rows and columns of which less than half is there, while the grid exceeds
    /// `long` x `short`: a board's outer edge makes crossings with what lies behind it.
    pub(super) fn strip(&mut self, long: usize, short: usize) {
        while self.cols.max(self.rows) > long || self.cols.min(self.rows) > short {
            let sparse = |cells: &mut dyn Iterator<Item = usize>| {
                let (mut count, mut all) = (0, 0);
                for k in cells {
                    all += 1;
                    count += usize::from(self.cells[k].is_some());
                }
                2 * count < all
            };
            let (cols, rows) = (self.cols, self.rows);
            let (c, r) = if sparse(&mut (0..cols)) {
                (0..cols, 1..rows)
            } else if sparse(&mut ((rows - 1) * cols..rows * cols)) {
                (0..cols, 0..rows - 1)
            } else if sparse(&mut (0..rows).map(|r| r * cols)) {
                (1..cols, 0..rows)
            } else if sparse(&mut (0..rows).map(|r| (r + 1) * cols - 1)) {
                (0..cols - 1, 0..rows)
            } else {
                return;
            };
            let kept = r.clone().flat_map(|r| c.clone().map(move |c| r * cols + c));
            self.cells = kept.map(|k| self.cells[k]).collect();
            (self.cols, self.rows) = (c.len(), r.len());
        }
    }

    /// A quarter turn of the labels: columns become rows (handedness kept).
    pub(super) fn turned(&self) -> Self {
        let (cols, rows) = (self.rows, self.cols);
        let mut cells = vec![None; cols * rows];
        for r in 0..self.rows {
            for c in 0..self.cols {
                // New +u is old +v, new +v is old -u; the first square is then the old one
                // towards -u +v, of the other colour.
                cells[(self.cols - 1 - c) * cols + r] = self.at(c, r).map(|cell| Cell {
                    at: cell.at,
                    dark: !cell.dark,
                });
            }
        }
        Self { cols, rows, cells }
    }
}

type Links = Vec<[Option<(usize, usize)>; 4]>;

/// All connected grids, largest first. Of contradictory labels, those nearer to the strongest
/// crossing win: contradictions come from false crossings around a board, and whatever of them
/// remains is left to the check of regularity.
pub(super) fn grids(saddles: &[Saddle]) -> Vec<Grid> {
    let mut links = mutual(&nearest(saddles));
    drop_uneven(saddles, &mut links);
    let mut labels: Vec<Option<Label>> = vec![None; saddles.len()];
    let mut found = Vec::new();
    for seed in 0..saddles.len() {
        if labels[seed].is_none()
            && let members = grow(seed, &links, &mut labels)
            && members.len() >= 4
            && let Some(grid) = boxed(&members, saddles, &labels)
        {
            found.push(grid);
        }
    }
    found.sort_by_key(|g: &Grid| core::cmp::Reverse(g.count()));
    found
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Label {
    col: i32,
    row: i32,
    /// Ray that points along growing columns.
    along: usize,
}

/// For each ray of each crossing: the nearest crossing along it, and its ray that points back.
fn nearest(saddles: &[Saddle]) -> Links {
    // Rays are read on a ring of 5 px: a few degrees of error, plus perspective and lens.
    const COS: f64 = 0.93;
    let mut links = vec![[None; 4]; saddles.len()];
    for (i, a) in saddles.iter().enumerate() {
        let mut best = [f64::INFINITY; 4];
        for (j, b) in saddles.iter().enumerate() {
            let v = b.at - a.at;
            let length = v.norm();
            // The ring of a crossing must not reach beyond its squares.
            if i == j || length < 7.0 {
                continue;
            }
            let direction = v / length;
            let (k, cos) = a.ray_towards(&direction);
            let (back, cos_back) = b.ray_towards(&-direction);
            if cos < COS || cos_back < COS || length >= best[k] {
                continue;
            }
            // Seen from the other end the edge's sides swap.
            if a.dark_after(k) != b.dark_after((back + 3) % 4) {
                continue;
            }
            best[k] = length;
            links[i][k] = Some((j, back));
        }
    }
    links
}

fn mutual(links: &Links) -> Links {
    let mut kept = vec![[None; 4]; links.len()];
    for (i, rays) in links.iter().enumerate() {
        for (k, link) in rays.iter().enumerate() {
            if let Some((j, back)) = *link
                && links[j][back] == Some((i, k))
            {
                kept[i][k] = Some((j, back));
            }
        }
    }
    kept
}

/// Of two links in line, drops the one much longer than the other: it leaves the board.
fn drop_uneven(saddles: &[Saddle], links: &mut Links) {
    // Perspective and lens change the length from square to square by less than this.
    const RATIO: f64 = 1.6;
    for i in 0..saddles.len() {
        for k in 0..2 {
            let (Some((a, back_a)), Some((b, back_b))) = (links[i][k], links[i][k + 2]) else {
                continue;
            };
            let (la, lb) = (
                (saddles[a].at - saddles[i].at).norm(),
                (saddles[b].at - saddles[i].at).norm(),
            );
            if la > RATIO * lb {
                links[i][k] = None;
                links[a][back_a] = None;
            } else if lb > RATIO * la {
                links[i][k + 2] = None;
                links[b][back_b] = None;
            }
        }
    }
}

/// Labels everything reachable from `seed`, nearest first.
fn grow(seed: usize, links: &Links, labels: &mut [Option<Label>]) -> Vec<usize> {
    labels[seed] = Some(Label {
        col: 0,
        row: 0,
        along: 0,
    });
    let mut members = vec![seed];
    let mut next = 0;
    while next < members.len() {
        let i = members[next];
        next += 1;
        let Some(here) = labels[i] else { continue };
        for (k, link) in links[i].iter().enumerate() {
            let Some((j, back)) = *link else { continue };
            let side = (k + 4 - here.along) % 4;
            let (dc, dr) = [(1, 0), (0, 1), (-1, 0), (0, -1)][side];
            let label = Label {
                col: here.col + dc,
                row: here.row + dr,
                // The ray that points back is opposite to the side we came along.
                along: (back + 6 - side) % 4,
            };
            if labels[j].is_none() {
                labels[j] = Some(label);
                members.push(j);
            }
        }
    }
    members
}

/// Puts labelled crossings, nearest first, into their bounding box.
fn boxed(members: &[usize], saddles: &[Saddle], labels: &[Option<Label>]) -> Option<Grid> {
    let all = || members.iter().filter_map(|&i| labels[i].map(|l| (i, l)));
    let col0 = all().map(|(_, l)| l.col).min()?;
    let row0 = all().map(|(_, l)| l.row).min()?;
    let cols = usize::try_from(all().map(|(_, l)| l.col).max()? - col0).ok()? + 1;
    let rows = usize::try_from(all().map(|(_, l)| l.row).max()? - row0).ok()? + 1;
    let mut cells = vec![None; cols * rows];
    for (i, label) in all() {
        let c = usize::try_from(label.col - col0).ok()?;
        let r = usize::try_from(label.row - row0).ok()?;
        let cell = &mut cells[r * cols + c];
        if cell.is_some() {
            continue;
        }
        *cell = Some(Cell {
            at: saddles[i].at,
            dark: saddles[i].dark_after(label.along),
        });
    }
    Some(Grid { cols, rows, cells })
}
