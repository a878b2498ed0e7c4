//! A page: headings, tables, charts; the charts' script is inlined once.

use std::fmt::Write;

use plotly::configuration::DisplayModeBar;
use plotly::{Configuration, Plot};

/// An HTML page under construction.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    body: String,
    plots: usize,
}

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:1240px;\
margin:2em auto;padding:0 1em}h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em;clear:both}\
.scroll{overflow-x:auto}table.grid td,table.grid th{white-space:nowrap}table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em 1em .2em 0;text-align:left;\
border-bottom:1px solid #ddd;vertical-align:top}td.n{text-align:right}\
pre{background:#f6f6f6;padding:1em;overflow:auto}.chart{display:inline-block;width:49%;\
vertical-align:top}.note{margin:0 1.5em 1.5em 0;font-size:13px;color:#555}.wide{display:block;width:100%}figure{display:inline-block;margin:.5em;\
width:47%}figure svg{width:100%;height:auto}@media(max-width:900px){.chart,figure{width:100%}}";

impl Page {
    /// A page with a title.
    pub fn new(title: &str) -> Self {
        Self {
            title: title.to_owned(),
            body: format!("<h1>{}</h1>\n", escaped(title)),
            plots: 0,
        }
    }

    /// A heading.
    pub fn heading(&mut self, text: &str) {
        let _ = writeln!(self.body, "<h2>{}</h2>", escaped(text));
    }

    /// A paragraph.
    pub fn text(&mut self, text: &str) {
        let _ = writeln!(self.body, "<p>{}</p>", escaped(text));
    }

    /// Rows of names and values.
    pub fn table(&mut self, rows: &[(String, String)]) {
        let rows: Vec<Vec<String>> = rows
            .iter()
            .map(|(name, value)| vec![name.clone(), value.clone()])
            .collect();
        self.grid(&[], &rows);
    }

    /// A table with a heading for each column; a value that is a number stands on the right.
    pub fn grid(&mut self, columns: &[&str], rows: &[Vec<String>]) {
        // What stands under headings is short; on a narrow screen it is scrolled, not broken.
        let class = if columns.is_empty() {
            ""
        } else {
            " class=\"grid\""
        };
        let _ = writeln!(self.body, "<div class=\"scroll\"><table{class}>");
        if !columns.is_empty() {
            self.body.push_str("<tr>");
            for column in columns {
                let _ = write!(self.body, "<th>{}</th>", escaped(column));
            }
            self.body.push_str("</tr>\n");
        }
        for row in rows {
            self.body.push_str("<tr>");
            for value in row {
                let class = if value.parse::<f64>().is_ok() {
                    " class=\"n\""
                } else {
                    ""
                };
                let _ = write!(self.body, "<td{class}>{}</td>", escaped(value));
            }
            self.body.push_str("</tr>\n");
        }
        self.body.push_str("</table></div>\n");
    }

    /// A text that is shown on demand.
    pub fn folded(&mut self, summary: &str, text: &str) {
        let _ = writeln!(
            self.body,
            "<details><summary>{}</summary><pre>{}</pre></details>",
            escaped(summary),
            escaped(text)
        );
    }

    /// A chart of this height \[px\]; above 500 px it takes the whole width.
    pub fn plot(&mut self, id: &str, height: u32, plot: &Plot) {
        self.explained(id, height, plot, "");
    }

    /// The same with how to read it below.
    pub fn explained(&mut self, id: &str, height: u32, plot: &Plot, words: &str) {
        self.plots += 1;
        let class = if height > 500 { "wide" } else { "chart" };
        // A name in the data must not end the script.
        let mut plot = plot.clone();
        plot.set_configuration(
            Configuration::new()
                .responsive(true)
                .display_logo(false)
                .display_mode_bar(DisplayModeBar::Hover),
        );
        let data = plot.to_json().replace("</", "<\\/");
        let _ = writeln!(
            self.body,
            "<div class=\"{class}\"><div id=\"{id}\" style=\"height:{height}px\"></div>\
             <p class=\"note\">{}</p></div><script>Plotly.newPlot(\"{id}\",{data});</script>",
            escaped(words)
        );
    }

    /// Markup as it is.
    pub fn html(&mut self, markup: &str) {
        self.body.push_str(markup);
    }

    /// The whole page.
    pub fn render(&self) -> String {
        let script = if self.plots > 0 {
            library()
        } else {
            String::new()
        };
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width\">\
             <title>{}</title><style>{STYLE}</style>\n{script}</head>\n<body>\n{}\
             <p><small>needle-steer {}. Research software, not a medical device.</small></p>\n\
             </body></html>\n",
            escaped(&self.title),
            self.body,
            escaped(crate::VERSION)
        )
    }
}

/// The first of plotly's scripts: the second sets formulas, which no chart has.
fn library() -> String {
    const END: &str = "</script>";
    let mut scripts = Plot::offline_js_sources();
    if let Some(end) = scripts.find(END) {
        scripts.truncate(end + END.len());
    }
    scripts
}

/// Text in place of markup.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use plotly::Scatter;

    #[test]
    fn the_script_is_inlined_once_and_nothing_is_fetched() {
        let mut page = Page::new("a <b> & \"c\"");
        for id in ["one", "two"] {
            let mut plot = Plot::new();
            plot.add_trace(Scatter::new(vec![0.0, f64::NAN], vec![1.0, 2.0]).name("</script>"));
            page.plot(id, 300, &plot);
        }
        let html = page.render();
        assert_eq!(html.matches("<script").count(), 3);
        assert_eq!(html.matches("</script>").count(), 3);
        assert!(!html.contains("<script src") && !html.contains("<link"));
        assert!(html.contains("a &lt;b&gt; &amp; &quot;c&quot;"));
        assert!(html.contains("null"), "NaN is a gap");
    }
}
