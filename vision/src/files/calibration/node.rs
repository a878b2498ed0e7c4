//! A file's content, whatever its syntax: YAML, JSON or XML.

use nalgebra::DMatrix;

/// A value of a file.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::files) enum Node {
    Number(f64),
    Text(String),
    List(Vec<Node>),
    /// In the file's order.
    Map(Vec<(String, Node)>),
    Null,
}

impl Node {
    /// The value of a key; keys compare by their letters and digits.
    pub(in crate::files) fn get(&self, key: &str) -> Option<&Self> {
        let Self::Map(entries) = self else {
            return None;
        };
        let found = entries.iter().find(|(name, _)| plain(name) == plain(key));
        found.map(|(_, value)| value)
    }

    /// A finite number.
    pub(in crate::files) fn number(&self) -> Option<f64> {
        match self {
            Self::Number(n) => Some(*n).filter(|n| n.is_finite()),
            Self::List(one) => match one.as_slice() {
                [n] => n.number(),
                _ => None,
            },
            _ => None,
        }
    }

    /// A text.
    pub(in crate::files) fn text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    /// A count above zero.
    pub(in crate::files) fn count(&self) -> Option<usize> {
        let n = self.number()?;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a whole number in range"
        )]
        ((1.0..=1e6).contains(&n) && n.fract() == 0.0).then_some(n as usize)
    }

    /// A matrix: `rows`, `cols` and row-major `data`; a list of rows; or a list of numbers, which
    /// makes a column. All its numbers are finite.
    pub(in crate::files) fn matrix(&self) -> Option<DMatrix<f64>> {
        match self {
            Self::Map(_) => {
                let (rows, cols) = (self.get("rows")?.count()?, self.get("cols")?.count()?);
                let data = self.get("data")?.numbers()?;
                (rows.checked_mul(cols) == Some(data.len()))
                    .then(|| DMatrix::from_row_slice(rows, cols, &data))
            }
            Self::List(rows) if rows.iter().all(|r| matches!(r, Self::List(_))) => {
                let rows: Vec<Vec<f64>> = rows.iter().map(Self::numbers).collect::<Option<_>>()?;
                let cols = rows.first()?.len();
                (cols > 0 && rows.iter().all(|r| r.len() == cols))
                    .then(|| DMatrix::from_row_slice(rows.len(), cols, &rows.concat()))
            }
            Self::List(_) | Self::Number(_) => {
                let data = self.numbers()?;
                Some(DMatrix::from_row_slice(data.len(), 1, &data))
            }
            _ => None,
        }
    }

    /// Finite numbers in a list, or one alone.
    fn numbers(&self) -> Option<Vec<f64>> {
        match self {
            Self::Number(_) => Some(vec![self.number()?]),
            Self::List(list) => list.iter().map(Self::number).collect(),
            _ => None,
        }
    }

    /// Whether the value is one thing, not a group of keys: a matrix counts as one.
    pub(in crate::files) fn is_leaf(&self) -> bool {
        match self {
            Self::Map(_) => self.get("data").is_some(),
            _ => true,
        }
    }
}

/// A key's letters and digits, in lower case: `Camera_Matrix` is `cameramatrix`.
pub(in crate::files) fn plain(key: &str) -> String {
    key.chars()
        .filter(|c| c.is_alphanumeric())
        .flat_map(char::to_lowercase)
        .collect()
}
