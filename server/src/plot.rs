//! Plots as PNG, with a font of their own: charts of lines and points, and pictures of fields with a colour bar.

use std::sync::Once;

use image::{ExtendedColorType, ImageEncoder};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;

/// The font's name within plotters.
const FONT: &str = "welkin";
/// Pixels of text.
const TEXT: i32 = 15;
const TITLE: i32 = 17;
/// Share of the height that is added above and below where points have notes.
const NOTES_MARGIN: f64 = 0.12;
/// Pixels for a picture's colour bar.
const BAR: u32 = 86;

/// Colours that stay apart for those who see red and green alike (Okabe and Ito 2008).
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(60, 60, 60),
    RGBColor(150, 120, 60),
];

/// Why a plot could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("cannot draw: {0}")]
pub struct PlotError(String);

fn why(error: impl std::fmt::Display) -> PlotError {
    PlotError(error.to_string())
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// A line.
    Line,
    /// A broken line, for what others have published.
    Dashes,
    /// Points.
    Dots,
    /// Points with rings around them.
    Rings,
}

/// A series of a chart.
#[derive(Clone, Debug)]
pub struct Series {
    /// What the legend says; empty for no entry.
    pub label: String,
    /// Points `[x, y]`; those that are not finite are left out.
    pub points: Vec<[f64; 2]>,
    /// How it is drawn.
    pub mark: Mark,
    /// Which colour, counted round.
    pub colour: usize,
}

impl Series {
    /// A line in the given colour.
    pub fn line(label: impl Into<String>, colour: usize, points: Vec<[f64; 2]>) -> Self {
        Self {
            label: label.into(),
            points,
            mark: Mark::Line,
            colour,
        }
    }

    /// The same, drawn otherwise.
    pub fn drawn(self, mark: Mark) -> Self {
        Self { mark, ..self }
    }
}

/// A chart with two axes.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    /// Above it.
    pub title: String,
    /// What the axes are, with units.
    pub axes: [String; 2],
    /// Whether an axis is logarithmic.
    pub log: [bool; 2],
    /// What is drawn.
    pub series: Vec<Series>,
    /// Shaded ranges of y, such as those of an intercomparison.
    pub bands: Vec<[f64; 2]>,
    /// Shaded ranges of x.
    pub columns: Vec<[f64; 2]>,
    /// Where the legend stands: its side right (else left) and bottom (else top).
    pub legend: [bool; 2],
    /// Text beside points: `[x, y]` and the text.
    pub notes: Vec<([f64; 2], String)>,
}

/// A field as a picture.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Above it.
    pub title: String,
    /// What the axes are, with units.
    pub axes: [String; 2],
    /// Least and largest coordinate along both axes.
    pub extent: [[f64; 2]; 2],
    /// Values in rows from below, `width` in each.
    pub values: Vec<f32>,
    /// Values in a row.
    pub width: usize,
    /// Values at the ends of the colour bar; 0 is white where it lies between.
    pub range: [f64; 2],
}

/// One plot of several.
#[derive(Clone, Debug)]
pub enum Panel {
    /// See [`Chart`].
    Chart(Chart),
    /// See [`Picture`].
    Picture(Picture),
}

/// Draws panels in rows of `columns`, each of `size` pixels, and encodes them as PNG.
///
/// Errors: [`PlotError`] where the font or the encoder fails.
pub fn png(panels: &[Panel], columns: usize, size: [u32; 2]) -> Result<Vec<u8>, PlotError> {
    use_own_font();
    let columns = columns.max(1);
    let rows = panels.len().div_ceil(columns).max(1);
    let [width, height] = [size[0] * columns as u32, size[1] * rows as u32];
    let mut pixels = vec![255; width as usize * height as usize * 3];
    {
        let root = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
        root.fill(&WHITE).map_err(why)?;
        for (panel, area) in panels.iter().zip(root.split_evenly((rows, columns))) {
            match panel {
                Panel::Chart(chart) => draw_chart(chart, &area)?,
                Panel::Picture(picture) => draw_picture(picture, &area)?,
            }
        }
        root.present().map_err(why)?;
    }
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(&pixels, width, height, ExtendedColorType::Rgb8)
        .map_err(why)?;
    Ok(bytes)
}

fn use_own_font() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        for style in [FontStyle::Normal, FontStyle::Bold] {
            // A font that is not understood shows in the first text that is drawn with it.
            let _ = register_font(FONT, style, epaint_default_fonts::UBUNTU_LIGHT);
        }
    });
}

type Area<'a, 'b> = DrawingArea<BitMapBackend<'a>, Shift>;

/// A coordinate as it is drawn: itself, or its logarithm.
fn drawn(value: f64, log: bool) -> f64 {
    if log { value.max(1e-300).log10() } else { value }
}

/// Least and largest of what is to be seen, with a margin.
fn bounds(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
    if low > high {
        return 0.0..1.0;
    }
    let margin = if high > low {
        0.06 * (high - low)
    } else {
        0.5 * high.abs().max(1.0)
    };
    low - margin..high + margin
}

/// A number as short as the axis allows.
fn number(value: f64, log: bool) -> String {
    if log {
        let power = 10f64.powf(value);
        return if (1e-3..1e5).contains(&power) {
            // Three digits that count.
            let unit = 10f64.powf(value.floor() - 2.0);
            short((power / unit).round() * unit)
        } else {
            format!("{power:.1e}")
        };
    }
    short(value)
}

fn short(value: f64) -> String {
    if value == 0.0 || value.abs() < 1e-12 {
        return "0".to_owned();
    }
    if !(1e-3..1e6).contains(&value.abs()) {
        return format!("{value:.1e}");
    }
    let digits = (3 - value.abs().log10().floor() as i32).clamp(0, 6) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

fn draw_chart(chart: &Chart, area: &Area) -> Result<(), PlotError> {
    let [log_x, log_y] = chart.log;
    let seen = || chart.series.iter().flat_map(|s| &s.points);
    let x = bounds(
        seen()
            .map(|p| drawn(p[0], log_x))
            .chain(chart.columns.iter().flatten().copied()),
    );
    let y = bounds(
        seen()
            .map(|p| drawn(p[1], log_y))
            .chain(chart.bands.iter().flatten().copied()),
    );
    // Room for the text beside the points, and for the legend below it.
    let y = if chart.notes.is_empty() {
        y
    } else {
        let margin = NOTES_MARGIN * (y.end - y.start);
        y.start - margin..y.end + margin
    };
    let mut frame = ChartBuilder::on(area)
        .caption(&chart.title, (FONT, TITLE))
        .margin(12)
        .x_label_area_size(46)
        .y_label_area_size(74)
        .build_cartesian_2d(x.clone(), y.clone())
        .map_err(why)?;
    frame
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .label_style((FONT, TEXT))
        .axis_desc_style((FONT, TEXT))
        .x_desc(&chart.axes[0])
        .y_desc(&chart.axes[1])
        .x_labels(6)
        .y_labels(7)
        .x_label_formatter(&|v| number(*v, log_x))
        .y_label_formatter(&|v| number(*v, log_y))
        .draw()
        .map_err(why)?;
    let shade = RGBColor(90, 90, 90).mix(0.13).filled();
    for [low, high] in &chart.bands {
        let corners = [(x.start, drawn(*low, log_y)), (x.end, drawn(*high, log_y))];
        frame.draw_series([Rectangle::new(corners, shade)]).map_err(why)?;
    }
    for [low, high] in &chart.columns {
        let corners = [(drawn(*low, log_x), y.start), (drawn(*high, log_x), y.end)];
        frame.draw_series([Rectangle::new(corners, shade)]).map_err(why)?;
    }
    for series in &chart.series {
        draw_series(&mut frame, series, chart.log)?;
    }
    for (i, (at, text)) in chart.notes.iter().enumerate() {
        let at = (drawn(at[0], log_x), drawn(at[1], log_y));
        // Towards the middle, and neighbours at different heights, so that less of the text is cut or covered.
        let left = at.0 > 0.5 * (x.start + x.end);
        let wide = (0.5 * f64::from(TEXT - 2) * text.len() as f64) as i32;
        let shift = (if left { -wide - 8 } else { 9 }, [-22, 8, -7][i % 3]);
        let label = EmptyElement::at(at) + Text::new(text.clone(), shift, (FONT, TEXT - 2));
        frame.draw_series([label]).map_err(why)?;
    }
    if chart.series.iter().any(|s| !s.label.is_empty()) {
        frame
            .configure_series_labels()
            .position(match chart.legend {
                [false, false] => SeriesLabelPosition::UpperLeft,
                [true, false] => SeriesLabelPosition::UpperRight,
                [false, true] => SeriesLabelPosition::LowerLeft,
                [true, true] => SeriesLabelPosition::LowerRight,
            })
            .background_style(WHITE.mix(0.85))
            .border_style(RGBColor(200, 200, 200))
            .label_font((FONT, TEXT))
            .draw()
            .map_err(why)?;
    }
    Ok(())
}

type Frame<'a, 'b> = ChartContext<
    'a,
    BitMapBackend<'b>,
    Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>,
>;

fn draw_series(frame: &mut Frame, series: &Series, log: [bool; 2]) -> Result<(), PlotError> {
    let colour = COLOURS[series.colour % COLOURS.len()];
    let points: Vec<(f64, f64)> = series
        .points
        .iter()
        .map(|p| (drawn(p[0], log[0]), drawn(p[1], log[1])))
        .filter(|p| p.0.is_finite() && p.1.is_finite())
        .collect();
    let line = colour.stroke_width(2);
    let entry = match series.mark {
        Mark::Line => frame.draw_series(LineSeries::new(points, line)).map_err(why)?,
        Mark::Dashes => frame
            .draw_series(DashedLineSeries::new(points, 7, 5, line))
            .map_err(why)?,
        Mark::Dots => frame
            .draw_series(points.into_iter().map(|p| Circle::new(p, 5, colour.filled())))
            .map_err(why)?,
        Mark::Rings => frame
            .draw_series(points.into_iter().map(|p| Circle::new(p, 9, colour.stroke_width(2))))
            .map_err(why)?,
    };
    if !series.label.is_empty() {
        let mark = series.mark;
        entry.label(series.label.clone()).legend(move |(x, y)| {
            let shape: Vec<(i32, i32)> = match mark {
                Mark::Line => vec![(x, y), (x + 18, y)],
                Mark::Dashes => vec![(x, y), (x + 6, y)],
                Mark::Dots | Mark::Rings => vec![(x + 7, y), (x + 11, y)],
            };
            PathElement::new(shape, colour.stroke_width(if mark == Mark::Dots { 5 } else { 2 }))
        });
    }
    Ok(())
}

/// Blue through white to red where 0 lies inside the range, else white to dark blue.
fn colour_of(value: f64, [low, high]: [f64; 2]) -> RGBColor {
    let mix = |a: [f64; 3], b: [f64; 3], t: f64| {
        let part = |i: usize| (a[i] + (b[i] - a[i]) * t.clamp(0.0, 1.0)).round() as u8;
        RGBColor(part(0), part(1), part(2))
    };
    const WHITE: [f64; 3] = [250.0, 250.0, 250.0];
    const BLUE: [f64; 3] = [5.0, 60.0, 140.0];
    const RED: [f64; 3] = [165.0, 15.0, 20.0];
    if low < 0.0 && value < 0.0 {
        mix(WHITE, BLUE, value / low)
    } else if low < 0.0 {
        mix(WHITE, RED, if high > 0.0 { value / high } else { 0.0 })
    } else {
        mix(WHITE, BLUE, (value - low) / (high - low))
    }
}

fn draw_picture(picture: &Picture, area: &Area) -> Result<(), PlotError> {
    let (width, _) = area.dim_in_pixel();
    let (left, right) = area.split_horizontally(width.saturating_sub(BAR));
    let [[x0, x1], [y0, y1]] = picture.extent;
    let mut frame = ChartBuilder::on(&left)
        .caption(&picture.title, (FONT, TITLE))
        .margin(12)
        .x_label_area_size(46)
        .y_label_area_size(66)
        .build_cartesian_2d(x0..x1, y0..y1)
        .map_err(why)?;
    let columns = picture.width.max(1);
    let rows = picture.values.len() / columns;
    // Drawn pixel by pixel of the frame, each from the cell that it lies in, so that cells finer than a pixel cost nothing.
    let (across, up) = frame.plotting_area().dim_in_pixel();
    let step = [(x1 - x0) / f64::from(across), (y1 - y0) / f64::from(up)];
    for row in 0..up {
        let y = y0 + (f64::from(row) + 0.5) * step[1];
        let j = (((y - y0) / (y1 - y0) * rows as f64) as usize).min(rows.saturating_sub(1));
        for column in 0..across {
            let x = x0 + (f64::from(column) + 0.5) * step[0];
            let i = (((x - x0) / (x1 - x0) * columns as f64) as usize).min(columns - 1);
            let value = picture.values.get(j * columns + i).copied().unwrap_or(f32::NAN);
            frame
                .plotting_area()
                .draw_pixel((x, y), &colour_of(f64::from(value), picture.range))
                .map_err(why)?;
        }
    }
    frame
        .configure_mesh()
        .disable_mesh()
        .label_style((FONT, TEXT))
        .axis_desc_style((FONT, TEXT))
        .x_desc(&picture.axes[0])
        .y_desc(&picture.axes[1])
        .x_label_formatter(&|v| number(*v, false))
        .y_label_formatter(&|v| number(*v, false))
        .draw()
        .map_err(why)?;
    draw_bar(picture.range, &right)
}

fn draw_bar(range: [f64; 2], area: &Area) -> Result<(), PlotError> {
    let [low, high] = range;
    let mut bar = ChartBuilder::on(area)
        .caption(" ", (FONT, TITLE))
        .margin(12)
        .x_label_area_size(46)
        .y_label_area_size(46)
        .build_cartesian_2d(0.0..1.0, low..high)
        .map_err(why)?;
    const SHADES: i32 = 120;
    let step = (high - low) / f64::from(SHADES);
    bar.draw_series((0..SHADES).map(|i| {
        let bottom = low + f64::from(i) * step;
        let corners = [(0.0, bottom), (1.0, bottom + step)];
        Rectangle::new(corners, colour_of(bottom + 0.5 * step, range).filled())
    }))
    .map_err(why)?;
    bar.configure_mesh()
        .disable_mesh()
        .disable_x_axis()
        .label_style((FONT, TEXT))
        .y_labels(6)
        .y_label_formatter(&|v| number(*v, false))
        .draw()
        .map_err(why)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_and_a_picture_are_drawn_and_differ_from_blank() {
        let chart = Chart {
            title: "A chart".into(),
            axes: ["x, m".into(), "y, s".into()],
            log: [true, false],
            series: vec![
                Series::line("line", 0, vec![[1.0, 1.0], [10.0, 3.0], [f64::NAN, 2.0]]),
                Series::line("dots", 1, vec![[2.0, 2.0]]).drawn(Mark::Dots),
            ],
            bands: vec![[1.5, 2.5]],
            notes: vec![([2.0, 2.0], "here".into())],
            ..Chart::default()
        };
        let picture = Picture {
            title: "A field".into(),
            axes: ["x, km".into(), "z, km".into()],
            extent: [[0.0, 2.0], [0.0, 1.0]],
            values: vec![-1.0, 0.0, 0.5, 1.0],
            width: 2,
            range: [-1.0, 1.0],
        };
        let bytes = png(&[Panel::Chart(chart), Panel::Picture(picture)], 2, [300, 200]).unwrap();
        let image = image::load_from_memory(&bytes).unwrap().to_rgb8();
        assert_eq!(image.dimensions(), (600, 200));
        let colours: std::collections::HashSet<_> = image.pixels().map(|p| p.0).collect();
        assert!(colours.len() > 50, "only {} colours", colours.len());
        // The lower left cell is -1, the end of the scale.
        assert!(colours.contains(&[5, 60, 140]) && colours.contains(&[165, 15, 20]));
    }

    #[test]
    fn nothing_is_white_whatever_the_range() {
        let white = colour_of(0.0, [-1.0, 1.0]);
        assert_eq!(colour_of(0.0, [-10.0, 0.0]), white);
        assert_eq!(colour_of(3.0, [-10.0, 0.0]), white, "beyond the end");
        assert_eq!(colour_of(0.0, [0.0, 5.0]), white);
        assert_ne!(colour_of(5.0, [0.0, 5.0]), white);
    }

    #[test]
    fn an_empty_chart_is_no_failure() {
        png(&[Panel::Chart(Chart::default())], 1, [200, 150]).unwrap();
    }

    #[test]
    fn axis_numbers_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (1000.0, "1000"),
            (0.25, "0.25"),
            (-12.5, "-12.5"),
            (2e-5, "2.0e-5"),
        ] {
            assert_eq!(short(value), text);
        }
    }
}
