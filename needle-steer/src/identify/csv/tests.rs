use super::*;

const HEAD: [&str; 12] = [
    "t_s", "base_x_m", "base_y_m", "base_z_m", "base_qx", "base_qy", "base_qz", "base_qw",
    "tip_x_m", "tip_y_m", "tip_z_m", "points_m",
];

/// Rows of an insertion straight down at x = 0.4 m.
fn rows() -> Vec<Vec<String>> {
    let text = |numbers: &[f64]| numbers.iter().map(f64::to_string).collect::<Vec<_>>();
    (0..30)
        .map(|k| {
            let depth = 1e-3 * f64::from(k);
            let (base, tip) = (0.376 - depth, 0.25 - depth);
            let mut row = text(&[0.5 * f64::from(k), 0.4, 0.0, base, 1.0, 0.0, 0.0, 0.0]);
            row.extend(text(&[0.4, 8e-7 * f64::from(k * k), tip]));
            row.push(format!("0.4 0 {};0.4 0 {}", tip + 0.01, tip + 0.02));
            row
        })
        .collect()
}

fn table(head: &[&str], rows: &[Vec<String>], separator: &str, end: &str) -> String {
    let quoted = |cell: &String| {
        if cell.contains(';') {
            format!("\"{cell}\"")
        } else {
            cell.clone()
        }
    };
    let mut text = head.join(separator) + end;
    for row in rows {
        let cells: Vec<String> = row.iter().map(quoted).collect();
        text += &(cells.join(separator) + end);
    }
    text
}

fn read(name: &str, bytes: &[u8]) -> Result<Recording, RecordingError> {
    let file = std::env::temp_dir().join(format!("needle-{}-{name}", std::process::id()));
    std::fs::write(&file, bytes).unwrap();
    let read = Recording::read(&file, &Config::default());
    std::fs::remove_file(&file).unwrap();
    read
}

fn plain() -> String {
    table(&HEAD, &rows(), ",", "\n")
}

fn refused(name: &str, text: &str) -> String {
    let message = read(name, text.as_bytes()).unwrap_err().to_string();
    assert!(message.contains(name), "no file: {message}");
    message
}

/// Multiplies columns by a factor and renames them.
fn rescaled(
    columns: std::ops::Range<usize>,
    factor: f64,
    rename: impl Fn(&str) -> String,
) -> String {
    let head: Vec<String> = HEAD
        .iter()
        .enumerate()
        .map(|(k, name)| {
            if columns.contains(&k) {
                rename(name)
            } else {
                (*name).to_owned()
            }
        })
        .collect();
    let mut rows = rows();
    for row in &mut rows {
        for cell in &mut row[columns.clone()] {
            *cell = (cell.parse::<f64>().unwrap() * factor).to_string();
        }
    }
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    table(&head, &rows, ",", "\n")
}

#[test]
fn a_table_reads_the_same_in_every_usual_form() {
    let expected = read("plain.csv", plain().as_bytes()).unwrap().seen;
    assert_eq!((expected.len(), expected[3].shaft.len()), (30, 2));
    let mut comma = rows();
    for cell in comma.iter_mut().flatten() {
        *cell = cell.replace('.', ",");
    }
    let forms = [
        ("upper.CSV", plain()),
        ("data.txt", plain()),
        ("crlf.csv", table(&HEAD, &rows(), ",", "\r\n")),
        ("semicolon.csv", table(&HEAD, &rows(), ";", "\n")),
        ("tab.tsv", table(&HEAD, &rows(), "\t", "\n")),
        ("blanks.dat", table(&HEAD, &rows(), "  ", "\n")),
        ("comma.csv", table(&HEAD, &comma, ";", "\r\n")),
        ("comment.csv", format!("# trial 7\n{}# end\n", plain())),
        ("mark.csv", format!("\u{feff}{}", plain())),
        ("upper-case.csv", plain().replace("tip_x_m", "TIP_X_M")),
    ];
    for (name, text) in forms {
        let found = read(name, text.as_bytes()).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(found.seen, expected, "{name}");
    }
}

#[test]
fn times_count_from_the_first_row() {
    let mut late = rows();
    for row in &mut late {
        row[0] = (1_760_000_000.0 + row[0].parse::<f64>().unwrap()).to_string();
    }
    let text = table(&HEAD, &late, ",", "\n");
    let found = read("epoch.csv", text.as_bytes()).unwrap();
    assert_eq!(found.seen[3].stamp, Stamp::from_secs(1.5));
    let text = rescaled(0..1, 1e3, |_| "t_ms".to_owned());
    let found = read("ms.csv", text.as_bytes()).unwrap();
    assert_eq!(found.seen[3].stamp, Stamp::from_secs(1.5));
}

#[test]
fn units_come_from_the_headers() {
    let expected = read("metres.csv", plain().as_bytes()).unwrap();
    let text = rescaled(8..11, 1e3, |name| name.replace("_m", "_mm"));
    let found = read("tip-mm.csv", text.as_bytes()).unwrap();
    for (a, b) in found.seen.iter().zip(&expected.seen) {
        assert!((a.tip - b.tip).norm() < 1e-12);
    }
}

#[test]
fn lengths_that_do_not_fit_the_needle_are_refused() {
    let same = str::to_owned;
    let all_mm = rescaled(1..4, 1e3, same);
    let message = refused("base-mm.csv", &all_mm);
    assert!(
        message.contains(":2: tip_x_m: base and tip are"),
        "{message}"
    );
    assert!(
        message.contains("the needle is 126 mm long; are these lengths"),
        "{message}"
    );
    let tip_mm = refused("tip-mm.csv", &rescaled(8..11, 1e3, same));
    assert!(tip_mm.contains("apart"), "{tip_mm}");
    // One row alone.
    let mut one = rows();
    one[17][10] = "0.9".into();
    let message = refused("row.csv", &table(&HEAD, &one, ",", "\n"));
    assert!(message.contains(":19: tip_x_m"), "{message}");
    let mut far = rows();
    far[4][11] = "0.4 0 250".into();
    let message = refused("points.csv", &table(&HEAD, &far, ",", "\n"));
    assert!(
        message.contains(":6: points_m: a point of the shaft"),
        "{message}"
    );
}

#[test]
fn a_quaternion_in_another_order_is_noticed() {
    // (w, x, y, z) of a needle that points down the z axis reads as no turn at all.
    let mut turned = rows();
    for row in &mut turned {
        row.swap(4, 7);
    }
    let message = refused("order.csv", &table(&HEAD, &turned, ",", "\n"));
    assert!(message.contains("180 deg away from the tip"), "{message}");
}

#[test]
fn what_is_wrong_names_row_and_column() {
    let changed = |row: usize, column: usize, cell: &str| {
        let mut rows = rows();
        rows[row][column] = cell.to_owned();
        table(&HEAD, &rows, ",", "\r\n")
    };
    for (name, text, expected) in [
        (
            "a.csv",
            changed(2, 10, "x"),
            ":4: tip_z_m: expected a finite number, found `x`",
        ),
        (
            "b.csv",
            changed(2, 10, ""),
            ":4: tip_z_m: expected a finite number, found an empty",
        ),
        (
            "c.csv",
            changed(0, 3, "nan"),
            ":2: base_z_m: expected a finite number, found `nan`",
        ),
        (
            "d.csv",
            changed(5, 5, "1"),
            ":7: base_qx: expected a unit quaternion",
        ),
        (
            "e.csv",
            changed(5, 11, "0.4 0"),
            ":7: points_m: expected `x y z;x y z`",
        ),
        (
            "f.csv",
            changed(5, 0, "1"),
            ":7: t_s: expected a later time",
        ),
        (
            "g.csv",
            changed(5, 0, "1e9"),
            ":7: t_s: 1000000000 s after the first row",
        ),
        ("h.csv", plain().replace("tip_z_m,", ""), "found 12"),
        (
            "i.csv",
            plain().replace("tip_z_m", "tip_z"),
            ":1: column `tip_z` has no unit",
        ),
        (
            "j.csv",
            plain().replace("tip_z_m", "tipz_m"),
            "did you mean `tip_z_m`?",
        ),
        (
            "k.csv",
            plain().replace("tip_y_m", "tip_x_mm"),
            "say the same",
        ),
        (
            "l.csv",
            plain().replace("tip_z_m", "_tip"),
            "the columns tip_z_m are missing",
        ),
        (
            "m.csv",
            plain().replace("points_m", "axis_x"),
            "x: expected a finite number",
        ),
        ("n.csv", HEAD.join(","), "no measurement"),
    ] {
        let message = refused(name, &text);
        assert!(message.contains(expected), "{message}");
    }
}

/// What is not known of an optional column may be said in the words of other programs; numbers may
/// be spelled as they do.
#[test]
fn unknown_values_and_numbers_of_other_programs_are_read() {
    let mut head: Vec<&str> = HEAD.to_vec();
    head[11] = "sigma_mm";
    let mut spelled = rows();
    for (k, row) in spelled.iter_mut().enumerate() {
        row[11] = ["0.1", "NaN", "n/a", "-", "1D-1"][k % 5].into();
    }
    spelled[1][8] = spelled[1][8].replace('-', "\u{2212}");
    let found = read("spelled.csv", table(&head, &spelled, ",", "\n").as_bytes()).unwrap();
    let sigma: Vec<f64> = found.seen[..5].iter().map(|s| s.tip_sigma).collect();
    assert_eq!(sigma, [1e-4, SIGMA, SIGMA, SIGMA, 1e-4]);
    for (cell, expected) in [
        ("10:00:01", "found `10:00:01`; write seconds (`t_s`)"),
        ("s", "found `s`; write seconds"),
    ] {
        let mut rows = rows();
        rows[2][0] = cell.into();
        let message = refused("time.csv", &table(&HEAD, &rows, ",", "\n"));
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn two_kinds_of_decimal_marks_are_refused() {
    let mut mixed = rows();
    mixed[6][9] = "0,0001".into();
    let message = refused("mixed.csv", &table(&HEAD, &mixed, ";", "\n"));
    assert!(message.contains("`0,0001` in line 8"), "{message}");
}

#[test]
fn a_guide_needs_no_base_and_the_needle_slides_in_it() {
    let head: Vec<String> = HEAD
        .iter()
        .map(|name| name.replace("base", "guide"))
        .collect();
    let mut head: Vec<&str> = head.iter().map(String::as_str).collect();
    head[11] = "inserted_mm";
    let mut rows = rows();
    for (k, row) in rows.iter_mut().enumerate() {
        row[3] = "0.28".into();
        row[11] = format!("{k}");
    }
    let found = read("guide.csv", table(&head, &rows, ",", "\n").as_bytes()).unwrap();
    assert_eq!(found.support, Support::Guide);
    assert_eq!(found.seen[7].inserted, Some(7e-3));
    rows[3][3] = "0.6".into();
    let message = refused("guide.csv", &table(&head, &rows, ",", "\n"));
    assert!(
        message.contains("the needle is only 126 mm long"),
        "{message}"
    );
    head[11] = "base_x_m";
    let message = refused("both.csv", &table(&head, &rows, ",", "\n"));
    assert!(message.contains("not of both"), "{message}");
}

/// Draws from a fixed seed (SplitMix64).
struct Draws(u64);

impl Draws {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        usize::try_from((z ^ (z >> 31)) >> 1).unwrap() % bound
    }
}

/// One to three changes of bytes, cells or whole lines.
fn mutated(text: &str, draws: &mut Draws) -> Vec<u8> {
    const CELLS: [&str; 12] = [
        "", "nan", "inf", "1e400", "-1", "0", "1,5", "x", "\"", "#", "1e-9 m", "\u{feff}",
    ];
    let mut bytes = text.as_bytes().to_vec();
    for _ in 0..=draws.below(3) {
        let at = draws.below(bytes.len());
        let end = (at + 1 + draws.below(30)).min(bytes.len());
        match draws.below(7) {
            0 => bytes[at] ^= 1 << draws.below(8),
            1 => bytes[at] = u8::try_from(draws.below(256)).unwrap(),
            2 => drop(bytes.drain(at..end)),
            3 => bytes.extend_from_within(at..end),
            4 => bytes.truncate(at.max(1)),
            5 => {
                let mut lines: Vec<&[u8]> = bytes.split(|b| *b == b'\n').collect();
                let (a, b) = (draws.below(lines.len()), draws.below(lines.len()));
                lines.swap(a, b);
                bytes = lines.join(&b'\n');
            }
            _ => {
                let mut cells: Vec<&[u8]> = bytes.split(|b| *b == b',').collect();
                let k = draws.below(cells.len());
                cells[k] = CELLS[draws.below(CELLS.len())].as_bytes();
                bytes = cells.join(&b',');
            }
        }
        bytes.push(b'\n');
    }
    bytes
}

/// A table of any kind is read, or refused with one message that names file, place and what was
/// expected.
#[test]
fn a_thousand_mutated_tables_read_or_say_what_is_wrong() {
    let mut draws = Draws(23);
    let forms = [
        plain(),
        table(&HEAD, &rows(), ";", "\r\n"),
        table(&HEAD, &rows(), "\t", "\n"),
    ];
    let (mut sound, mut wrong) = (0, 0);
    for round in 0..1000 {
        let name = format!("mutated-{round}.csv");
        match read(&name, &mutated(&forms[round % 3], &mut draws)) {
            Ok(found) => {
                sound += 1;
                assert!(found.seen.iter().all(|s| s.tip.coords.norm() < 10.0));
            }
            Err(error) => {
                wrong += 1;
                let message = format!("{:#}", anyhow::Error::from(error));
                assert!(message.contains(&name), "{message}");
                let (_, rest) = message.split_once(&name).unwrap();
                let line = rest.strip_prefix(':').and_then(|r| r.split(':').next());
                let placed = line.is_some_and(|l| l.parse::<usize>().is_ok())
                    || rest.contains("are missing")
                    || rest.contains("no measurement")
                    || rest.contains("a file of an unknown kind");
                assert!(placed, "{message}");
                assert!(rest.len() > 20 && rest.len() < 600, "{message}");
            }
        }
    }
    assert!(sound > 10 && wrong > 500, "{sound} read, {wrong} refused");
}

#[test]
fn recordings_in_a_form_of_their_own_name_the_way() {
    for (name, header) in [
        (
            "topics.csv",
            "Timestamp sec,Timestamp nanosec,AuroraTip x,AuroraTip y",
        ),
        ("many.csv", "date,trial,step,t_s,guide_x_mm,tip_x_mm"),
    ] {
        let problem = refused(name, &format!("{header}\n"));
        assert!(problem.contains("REAL_NEEDLES.md"), "{problem}");
    }
}
