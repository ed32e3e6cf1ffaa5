//! Charts of what was measured: accuracy against frame time, and growth against size.
//!
//! A [`Chart`] is the data; SVG, PNG, CSV and JSON are views of it, so the numbers always lie beside the picture. A log
//! axis cannot show zero, and zero error is what is hoped for: such an axis has a floor, and whatever lies at or below it
//! is drawn *on* the floor as a triangle pointing down, with a dashed line that says so.

use kuva::prelude::{Layout, LinePlot, MarkerShape, Plot, ScatterPlot};
use kuva::render::annotations::ReferenceLine;
use serde::{Deserialize, Serialize};

/// One measurement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// What was measured, such as the name of a setting; may be empty.
    pub label: String,
    /// Horizontal value, in the unit of the axis.
    pub x: f64,
    /// Vertical value, in the unit of the axis.
    pub y: f64,
}

/// Points that belong together: one colour, one entry in the legend.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// The measurements, in the order in which a line joins them.
    pub points: Vec<Point>,
}

/// How an axis maps values to positions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// Proportional.
    Linear,
    /// Logarithmic; values at or below the floor are drawn on it.
    Log {
        /// Positive.
        floor: f64,
    },
}

/// One axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// What it shows, with its unit.
    pub label: String,
    /// Linear or logarithmic.
    pub scale: Scale,
}

/// A chart of points, joined or not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Chart {
    /// The line above.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// The data.
    pub series: Vec<Series>,
    /// Whether lines join the points of a series.
    pub joined: bool,
    /// Whether points carry their labels in the picture.
    pub labelled: bool,
}

/// Why a chart cannot be drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ChartError {
    /// There is no point.
    #[error("the chart {0:?} has no points")]
    Empty(String),
    /// A value is NaN or infinite.
    #[error("the chart's point {label:?} of series {series:?} is not finite: ({x}, {y}); leave it out")]
    NotFinite {
        /// The series' name.
        series: String,
        /// The point's label.
        label: String,
        /// Its horizontal value.
        x: f64,
        /// Its vertical value.
        y: f64,
    },
    /// The floor of a log axis is not a positive number.
    #[error("the floor of the logarithmic axis {axis:?} must be positive, not {floor}")]
    Floor {
        /// The axis' label.
        axis: String,
        /// Its floor.
        floor: f64,
    },
    /// The rasteriser failed.
    #[error("the chart could not be turned into pixels: {0}")]
    Raster(String),
}

/// Colours that are told apart with any kind of colour vision (Okabe and Ito, less the yellow, which vanishes on white).
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];
/// Once the colours repeat, the markers change.
const MARKERS: [MarkerShape; 4] = [MarkerShape::Circle, MarkerShape::Square, MarkerShape::Diamond, MarkerShape::Plus];
/// Radius of a marker, in the SVG's units.
const MARKER_SIZE: f64 = 4.0;
/// Picture size in the SVG's units; the PNG has twice as many pixels.
const SIZE: (f64, f64) = (760.0, 480.0);
/// Pixels of the PNG per unit of the SVG.
const PNG_SCALE: f32 = 2.0;

impl Scale {
    /// The value as it is drawn, and whether the floor lifted it.
    fn drawn(self, value: f64) -> (f64, bool) {
        match self {
            Scale::Log { floor } if value <= floor => (floor, true),
            _ => (value, false),
        }
    }
}

impl Chart {
    /// Accuracy against time, both axes logarithmic: `edge_px` in pixels over milliseconds. An edge error below a
    /// thousandth of a pixel is drawn there.
    pub fn accuracy_against_time(title: impl Into<String>, series: Vec<Series>) -> Self {
        const LEAST_EDGE_PX: f64 = 1e-3;
        const LEAST_MS: f64 = 1e-2;
        Self {
            title: title.into(),
            x: Axis { label: "frame time [ms]".to_owned(), scale: Scale::Log { floor: LEAST_MS } },
            y: Axis { label: "edge error [px]".to_owned(), scale: Scale::Log { floor: LEAST_EDGE_PX } },
            series,
            joined: false,
            labelled: true,
        }
    }

    /// Growth of some cost with some size, both axes logarithmic, points joined: a straight line of slope 1 is linear
    /// growth. Values at or below `floor` are drawn there.
    pub fn growth(
        title: impl Into<String>,
        size: impl Into<String>,
        cost: impl Into<String>,
        floor: f64,
        series: Vec<Series>,
    ) -> Self {
        let axis = |label| Axis { label, scale: Scale::Log { floor } };
        let (x, y) = (axis(size.into()), axis(cost.into()));
        Self { title: title.into(), x, y, series, joined: true, labelled: false }
    }

    /// Checks that the chart can be drawn.
    fn validate(&self) -> Result<(), ChartError> {
        for axis in [&self.x, &self.y] {
            if let Scale::Log { floor } = axis.scale
                && !(floor > 0.0 && floor.is_finite())
            {
                return Err(ChartError::Floor { axis: axis.label.clone(), floor });
            }
        }
        if self.series.iter().all(|series| series.points.is_empty()) {
            return Err(ChartError::Empty(self.title.clone()));
        }
        for series in &self.series {
            for Point { label, x, y } in &series.points {
                if !(x.is_finite() && y.is_finite()) {
                    let (series, label) = (series.name.clone(), label.clone());
                    return Err(ChartError::NotFinite { series, label, x: *x, y: *y });
                }
            }
        }
        Ok(())
    }

    /// What kuva draws.
    fn plots(&self) -> (Vec<Plot>, Layout) {
        let mut plots: Vec<Plot> = Vec::new();
        let (mut x_lifted, mut y_lifted) = (false, false);
        let (mut places, mut labels) = (Vec::new(), Vec::new());
        for (index, series) in self.series.iter().enumerate() {
            let colour = COLOURS[index % COLOURS.len()];
            let marker = MARKERS[index / COLOURS.len() % MARKERS.len()];
            let (mut plain, mut lifted) = (Vec::new(), Vec::new());
            let mut path = Vec::new();
            for point in &series.points {
                let (x, x_low) = self.x.scale.drawn(point.x);
                let (y, y_low) = self.y.scale.drawn(point.y);
                x_lifted |= x_low;
                y_lifted |= y_low;
                path.push((x, y));
                labels.push(plain_text(&point.label));
                if x_low || y_low { &mut lifted } else { &mut plain }.push((x, y));
            }
            places.extend_from_slice(&path);
            if self.joined && path.len() > 1 {
                plots.push(LinePlot::new().with_data(path).with_color(colour).into());
            }
            let scatter = |points: &[(f64, f64)], marker| {
                ScatterPlot::new()
                    .with_data(points.iter().copied())
                    .with_color(colour)
                    .with_size(MARKER_SIZE)
                    .with_marker(marker)
            };
            // The legend's entry comes from whichever marker the series has.
            let mut name = Some(plain_text(&series.name));
            for (points, marker) in [(&plain, marker), (&lifted, MarkerShape::TriangleDown)] {
                if !points.is_empty() {
                    let plot = scatter(points, marker);
                    plots.push(name.take().map_or(plot.clone(), |name| plot.with_legend(name)).into());
                }
            }
        }
        if self.labelled {
            // Labels of all series keep off each other only if they belong to one plot, whose own markers nobody sees.
            let carrier = ScatterPlot::new().with_data(places.iter().copied()).with_size(MARKER_SIZE);
            plots.push(carrier.with_marker_opacity(0.0).with_labels(labels).with_repel_labels().into());
        }
        let mut layout = Layout::auto_from_plots(&plots)
            .with_title(plain_text(&self.title))
            .with_x_label(plain_text(&self.x.label))
            .with_y_label(plain_text(&self.y.label))
            .with_width(SIZE.0)
            .with_height(SIZE.1);
        // On a log axis, room for the markers at the ends.
        const ROOM: f64 = 1.6;
        let range = |value: fn(&(f64, f64)) -> f64| {
            let values = || places.iter().map(value);
            (values().fold(f64::INFINITY, f64::min) / ROOM, values().fold(0.0, f64::max) * ROOM)
        };
        if let Scale::Log { floor } = self.x.scale {
            let (least, most) = range(|place| place.0);
            layout = layout.with_log_x().with_x_axis_min(least).with_x_axis_max(most);
            if x_lifted {
                layout = layout.with_reference_line(floor_line(ReferenceLine::vertical(floor), floor));
            }
        }
        if let Scale::Log { floor } = self.y.scale {
            let (least, most) = range(|place| place.1);
            layout = layout.with_log_y().with_y_axis_min(least).with_y_axis_max(most);
            if y_lifted {
                layout = layout.with_reference_line(floor_line(ReferenceLine::horizontal(floor), floor));
            }
        }
        (plots, layout)
    }

    /// The chart as SVG text.
    ///
    /// # Errors
    /// [`ChartError`] where there is nothing to draw or a value cannot be drawn.
    pub fn svg(&self) -> Result<String, ChartError> {
        self.validate()?;
        let (plots, layout) = self.plots();
        Ok(kuva::render_to_svg(plots, layout))
    }

    /// The chart as the bytes of a PNG file. Its font is built in.
    ///
    /// # Errors
    /// As [`Chart::svg`], or [`ChartError::Raster`].
    pub fn png(&self) -> Result<Vec<u8>, ChartError> {
        self.validate()?;
        let (plots, layout) = self.plots();
        kuva::render_to_raster(plots, layout, PNG_SCALE).map_err(ChartError::Raster)
    }

    /// The data as CSV: `series,label,x,y` under a header that names the axes.
    pub fn csv(&self) -> String {
        let quoted = |text: &str| {
            let plain = !text.contains([',', '"', '\n', '\r']);
            if plain { text.to_owned() } else { format!("\"{}\"", text.replace('"', "\"\"")) }
        };
        let mut csv = format!("series,label,{},{}\n", quoted(&self.x.label), quoted(&self.y.label));
        for series in &self.series {
            for Point { label, x, y } in &series.points {
                csv.push_str(&format!("{},{},{x},{y}\n", quoted(&series.name), quoted(label)));
            }
        }
        csv
    }

    /// The whole chart as JSON, which [`serde_json`] reads back.
    ///
    /// # Errors
    /// As [`Chart::svg`]: JSON has no infinities either.
    pub fn json(&self) -> Result<String, ChartError> {
        self.validate()?;
        // Strings and finite numbers always serialise.
        serde_json::to_string_pretty(self).map_err(|error| ChartError::Raster(error.to_string()))
    }

    /// The four files of a chart: extension and content.
    ///
    /// # Errors
    /// As [`Chart::png`].
    pub fn files(&self) -> Result<[(&'static str, Vec<u8>); 4], ChartError> {
        Ok([
            ("svg", self.svg()?.into_bytes()),
            ("png", self.png()?),
            ("csv", self.csv().into_bytes()),
            ("json", self.json()?.into_bytes()),
        ])
    }
}

fn floor_line(line: ReferenceLine, floor: f64) -> ReferenceLine {
    line.with_color("#999999").with_label(format!("{floor} or less"))
}

/// kuva reads `$…$` as mathematics; a dollar here is a dollar.
fn plain_text(text: &str) -> String {
    text.replace('$', "\\$")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(name: &str, points: &[(&str, f64, f64)]) -> Series {
        let point = |&(label, x, y): &(&str, f64, f64)| Point { label: label.to_owned(), x, y };
        Series { name: name.to_owned(), points: points.iter().map(point).collect() }
    }

    fn chart() -> Chart {
        let ours = series("surface", &[("nearest", 20.0, 0.4), ("curved", 31.0, 0.0), ("blend, 2", 25.0, 0.01)]);
        let paper = series("fragment", &[("two-nearest", 150.0, 5.5)]);
        Chart::accuracy_against_time("Accuracy against time", vec![ours, paper])
    }

    #[test]
    fn a_zero_is_drawn_on_the_floor_and_marked() {
        let svg = chart().svg().unwrap();
        assert!(svg.contains("<svg") && svg.contains("0.001 or less"));
        let mut without = chart();
        without.series[0].points[1].y = 0.1;
        assert!(!without.svg().unwrap().contains("or less"));
        assert_eq!(Scale::Log { floor: 0.1 }.drawn(0.0), (0.1, true));
        assert_eq!(Scale::Log { floor: 0.1 }.drawn(0.2), (0.2, false));
        assert_eq!(Scale::Linear.drawn(0.0), (0.0, false));
    }

    #[test]
    fn every_series_and_label_is_in_the_picture() {
        let svg = chart().svg().unwrap();
        for text in ["surface", "fragment", "nearest", "curved", "two-nearest", "frame time [ms]", "edge error [px]"] {
            assert!(svg.contains(text), "{text}");
        }
    }

    #[test]
    fn the_png_is_one() {
        let png = chart().png().unwrap();
        let image = image::load_from_memory(&png).unwrap();
        assert!(image.width() >= SIZE.0 as u32);
        let grey = image.to_luma8();
        assert!(grey.pixels().any(|p| p[0] < 64) && grey.pixels().any(|p| p[0] > 250));
    }

    #[test]
    fn the_data_lies_beside_the_picture() {
        let chart = chart();
        let csv = chart.csv();
        assert_eq!(csv.lines().next(), Some("series,label,frame time [ms],edge error [px]"));
        assert!(csv.contains("surface,\"blend, 2\",25,0.01\n"));
        assert_eq!(csv.lines().count(), 5);
        assert_eq!(serde_json::from_str::<Chart>(&chart.json().unwrap()).unwrap(), chart);
        assert_eq!(chart.files().unwrap().map(|file| file.0), ["svg", "png", "csv", "json"]);
    }

    #[test]
    fn growth_joins_its_points() {
        let times = series("classify", &[("", 1e4, 3.0), ("", 1e5, 40.0), ("", 1e6, 500.0)]);
        let chart = Chart::growth("Growth", "surfels", "time [ms]", 1e-3, vec![times]);
        assert!(chart.svg().unwrap().contains("classify"));
        let unjoined = Chart { joined: false, ..chart.clone() };
        assert!(chart.svg().unwrap().len() > unjoined.svg().unwrap().len());
    }

    #[test]
    fn what_cannot_be_drawn_is_refused() {
        let with = |change: &dyn Fn(&mut Chart)| {
            let mut chart = chart();
            change(&mut chart);
            chart.svg().unwrap_err()
        };
        assert!(matches!(with(&|c| c.series.clear()), ChartError::Empty(_)));
        assert!(matches!(with(&|c| c.series[0].points[0].y = f64::NAN), ChartError::NotFinite { .. }));
        assert!(matches!(with(&|c| c.y.scale = Scale::Log { floor: f64::NAN }), ChartError::Floor { .. }));
    }
}
