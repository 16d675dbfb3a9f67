//! Plots as PNG, with a font of their own: charts of lines and points, and pictures of fields with a colour bar.

use std::sync::Once;

use image::{ExtendedColorType, ImageEncoder};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::register_font;

/// The font's name within plotters.
const FONT: &str = "welkin";
/// Pixels of text.
const TEXT: i32 = 15;
const TITLE: i32 = 17;
/// Pixels around a chart, and for the numbers and the name of each axis.
const MARGIN: i32 = 12;
const X_TEXTS: i32 = 46;
const Y_TEXTS: i32 = 74;
/// Pixels of a legend: a row, what is before the text, and around it all.
const LEGEND_ROW: i32 = 20;
const LEGEND_MARK: i32 = 34;
const LEGEND_MARGIN: i32 = 8;
/// The least factor that a logarithmic axis spans, so that the chance of a clock does not look like a difference.
const LEAST_FACTOR: f64 = 3.0;
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
    /// Where the legend should stand: its side right (else left) and bottom (else top). It goes elsewhere where it would cover what is drawn, and outside if it does so everywhere.
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

/// Where an axis has its numbers, at most so many, as coordinates that are drawn: 1, 2 and 5 times powers of ten, on a logarithmic axis of many decades the powers alone.
fn ticks(range: &std::ops::Range<f64>, log: bool, most: usize) -> Vec<f64> {
    let steps = |low: f64, high: f64| {
        let rough = ((high - low) / most as f64).max(f64::MIN_POSITIVE);
        let unit = 10f64.powf(rough.log10().floor());
        let multiple = [1.0, 2.0, 5.0, 10.0].into_iter().find(|m| m * unit >= rough);
        let step = multiple.unwrap_or(10.0) * unit;
        let all = (low / step).ceil() as i64..=(high / step).floor() as i64;
        all.map(|n| n as f64 * step).collect::<Vec<f64>>()
    };
    if !log {
        return steps(range.start, range.end);
    }
    let decades = range.start.floor() as i32..=range.end.ceil() as i32;
    let at = |multiples: &[f64], each: usize| -> Vec<f64> {
        let powers = decades.clone().filter(|d| d.rem_euclid(each as i32) == 0);
        let all = powers.flat_map(|d| multiples.iter().map(move |m| f64::from(d) + m.log10()));
        all.filter(|v| range.contains(v)).collect()
    };
    let coarser = (1..).map(|each| at(&[1.0], each));
    let by_decades = [at(&[1.0, 2.0, 5.0], 1)]
        .into_iter()
        .chain(coarser)
        .find(|all| all.len() <= most)
        .unwrap_or_default();
    if by_decades.len() >= 3 {
        return by_decades;
    }
    // Less than a decade: steps that are equal in the value itself.
    let values = steps(10f64.powf(range.start), 10f64.powf(range.end));
    values.into_iter().filter(|v| *v > 0.0).map(f64::log10).collect()
}

/// A logarithmic axis that spans less than [`LEAST_FACTOR`] is widened around its middle.
fn widened(range: std::ops::Range<f64>, log: bool) -> std::ops::Range<f64> {
    let lacking = LEAST_FACTOR.log10() - (range.end - range.start);
    if log && lacking > 0.0 {
        range.start - 0.5 * lacking..range.end + 0.5 * lacking
    } else {
        range
    }
}

/// Pixels that so much text is wide, about.
fn text_width(text: &str, size: i32) -> i32 {
    (0.5 * f64::from(size) * text.chars().count() as f64) as i32
}

/// Where the text beside a point stands from it, pixels: towards the middle, and neighbours at different heights, so that less of the text is cut or covered.
fn note_shift(number: usize, text: &str, right_half: bool) -> (i32, i32) {
    let left = -text_width(text, TEXT - 2) - 8;
    (if right_half { left } else { 9 }, [-22, 8, -7][number % 3])
}

/// A chart's coordinates on the pixels of its frame, from the upper left.
struct OnPixels {
    ranges: [std::ops::Range<f64>; 2],
    size: [i32; 2],
}

impl OnPixels {
    fn at(&self, drawn: [f64; 2]) -> [i32; 2] {
        let [x, y] = [0, 1].map(|a| {
            let range = &self.ranges[a];
            (drawn[a] - range.start) / (range.end - range.start)
        });
        [
            (x * f64::from(self.size[0])) as i32,
            ((1.0 - y) * f64::from(self.size[1])) as i32,
        ]
    }
    /// Pixels, close together, that lines, points and notes cover.
    fn covered(&self, chart: &Chart) -> Vec<[i32; 2]> {
        const BETWEEN: usize = 60;
        let coordinates = |p: &[f64; 2]| [0, 1].map(|a| drawn(p[a], chart.log[a]));
        let mut all = Vec::new();
        for series in &chart.series {
            let points: Vec<[f64; 2]> = series
                .points
                .iter()
                .map(coordinates)
                .filter(|p| p.iter().all(|v| v.is_finite()))
                .collect();
            all.extend(points.iter().map(|p| self.at(*p)));
            if matches!(series.mark, Mark::Line | Mark::Dashes) {
                for pair in points.windows(2) {
                    all.extend((1..BETWEEN).map(|n| {
                        let share = n as f64 / BETWEEN as f64;
                        self.at([0, 1].map(|a| pair[0][a] + (pair[1][a] - pair[0][a]) * share))
                    }));
                }
            }
        }
        for (number, (at, text)) in chart.notes.iter().enumerate() {
            let [x, y] = self.at(coordinates(at));
            let (right, down) = note_shift(number, text, x > self.size[0] / 2);
            let wide = text_width(text, TEXT - 2);
            all.extend(
                (0..=wide)
                    .step_by(6)
                    .flat_map(|along| [0, TEXT].map(|height| [x + right + along, y + down + height])),
            );
        }
        all
    }
    /// Upper left corner of a legend of so many pixels where it covers nothing, the wanted corner first; none where there is no such place.
    fn free(&self, chart: &Chart, legend: [i32; 2]) -> Option<[i32; 2]> {
        let covered = self.covered(chart);
        let wanted = chart.legend.map(|end| f64::from(u8::from(end)));
        let places = [0.0, 1.0, 0.5].into_iter().flat_map(|x| [0.0, 1.0].map(|y| [x, y]));
        std::iter::once(wanted).chain(places).find_map(|place| {
            let corner = [0, 1].map(|a| {
                let room = self.size[a] - legend[a] - 2 * LEGEND_MARGIN;
                LEGEND_MARGIN + (place[a] * f64::from(room)) as i32
            });
            let is_in = |p: &[i32; 2]| (0..2).all(|a| (corner[a] - 8..=corner[a] + legend[a] + 8).contains(&p[a]));
            (corner.iter().all(|c| *c >= LEGEND_MARGIN) && !covered.iter().any(is_in)).then_some(corner)
        })
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
    let (x, y) = (widened(x, log_x), widened(y, log_y));
    // Room for the text beside the points.
    let y = if chart.notes.is_empty() {
        y
    } else {
        let margin = NOTES_MARGIN * (y.end - y.start);
        y.start - margin..y.end + margin
    };
    let entries: Vec<&Series> = chart.series.iter().filter(|s| !s.label.is_empty()).collect();
    let widest = entries.iter().map(|s| text_width(&s.label, TEXT)).max().unwrap_or(0);
    let legend = [
        LEGEND_MARK + widest + LEGEND_MARGIN,
        LEGEND_ROW * entries.len() as i32 + LEGEND_MARGIN,
    ];
    let (width, height) = area.dim_in_pixel();
    let pixels = OnPixels {
        ranges: [x.clone(), y.clone()],
        size: [
            width as i32 - 2 * MARGIN - Y_TEXTS,
            height as i32 - 2 * MARGIN - X_TEXTS - TITLE - 8,
        ],
    };
    let place = pixels.free(chart, legend);
    let outside = if place.is_none() && !entries.is_empty() {
        legend[0]
    } else {
        0
    };
    let mut frame = ChartBuilder::on(area)
        .caption(&chart.title, (FONT, TITLE))
        .margin(MARGIN)
        .margin_right(MARGIN + outside)
        .x_label_area_size(X_TEXTS)
        .y_label_area_size(Y_TEXTS)
        .build_cartesian_2d(Axis::new(&x, ticks(&x, log_x, 7)), Axis::new(&y, ticks(&y, log_y, 8)))
        .map_err(why)?;
    frame
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .label_style((FONT, TEXT))
        .axis_desc_style((FONT, TEXT))
        .x_desc(&chart.axes[0])
        .y_desc(&chart.axes[1])
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
        let shift = note_shift(i, text, at.0 > 0.5 * (x.start + x.end));
        let label = EmptyElement::at(at) + Text::new(text.clone(), shift, (FONT, TEXT - 2));
        frame.draw_series([label]).map_err(why)?;
    }
    let (plot_x, plot_y) = frame.plotting_area().get_pixel_range();
    let (area_x, area_y) = area.get_pixel_range();
    let plot = [plot_x.start - area_x.start, plot_y.start - area_y.start];
    let corner = place.unwrap_or([plot_x.end - plot_x.start + LEGEND_MARGIN, 0]);
    draw_legend(&entries, legend, [0, 1].map(|a| plot[a] + corner[a]), area)
}

/// A row a series: its mark, and what it is.
fn draw_legend(entries: &[&Series], size: [i32; 2], [left, top]: [i32; 2], area: &Area) -> Result<(), PlotError> {
    if entries.is_empty() {
        return Ok(());
    }
    let corners = [(left, top), (left + size[0], top + size[1])];
    area.draw(&Rectangle::new(corners, WHITE.filled())).map_err(why)?;
    area.draw(&Rectangle::new(corners, RGBColor(200, 200, 200)))
        .map_err(why)?;
    for (row, series) in entries.iter().enumerate() {
        let style = COLOURS[series.colour % COLOURS.len()].stroke_width(2);
        let y = top + LEGEND_MARGIN / 2 + LEGEND_ROW * row as i32 + LEGEND_ROW / 2;
        let x = left + 7;
        let dash = |from: i32, to: i32| area.draw(&PathElement::new(vec![(x + from, y), (x + to, y)], style));
        match series.mark {
            Mark::Line => dash(0, 20),
            Mark::Dashes => dash(0, 7).and_then(|()| dash(13, 20)),
            Mark::Dots => area.draw(&Circle::new((x + 10, y), 5, style.filled())),
            Mark::Rings => area.draw(&Circle::new((x + 10, y), 7, style)),
        }
        .map_err(why)?;
        let text = Text::new(
            series.label.clone(),
            (left + LEGEND_MARK, y - TEXT / 2 - 1),
            (FONT, TEXT),
        );
        area.draw(&text).map_err(why)?;
    }
    Ok(())
}

/// An axis with numbers where we want them.
struct Axis {
    along: RangedCoordf64,
    ticks: Vec<f64>,
}

impl Axis {
    fn new(range: &std::ops::Range<f64>, ticks: Vec<f64>) -> Axis {
        let along = range.clone().into();
        Axis { along, ticks }
    }
}

impl Ranged for Axis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        self.along.map(value, limit)
    }
    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        // Lines between the numbers are none.
        if hint.weight().allow_light_points() {
            Vec::new()
        } else {
            self.ticks.clone()
        }
    }
    fn range(&self) -> std::ops::Range<f64> {
        self.along.range()
    }
}

type Frame<'a, 'b> = ChartContext<'a, BitMapBackend<'b>, Cartesian2d<Axis, Axis>>;

fn draw_series(frame: &mut Frame, series: &Series, log: [bool; 2]) -> Result<(), PlotError> {
    let colour = COLOURS[series.colour % COLOURS.len()];
    let points: Vec<(f64, f64)> = series
        .points
        .iter()
        .map(|p| (drawn(p[0], log[0]), drawn(p[1], log[1])))
        .filter(|p| p.0.is_finite() && p.1.is_finite())
        .collect();
    let line = colour.stroke_width(2);
    match series.mark {
        Mark::Line => frame.draw_series(LineSeries::new(points, line)).map(|_| ()),
        Mark::Dashes => frame.draw_series(DashedLineSeries::new(points, 7, 5, line)).map(|_| ()),
        Mark::Dots => frame
            .draw_series(points.into_iter().map(|p| Circle::new(p, 5, colour.filled())))
            .map(|_| ()),
        Mark::Rings => frame
            .draw_series(points.into_iter().map(|p| Circle::new(p, 9, colour.stroke_width(2))))
            .map(|_| ()),
    }
    .map_err(why)
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

    #[test]
    fn axes_have_round_numbers() {
        let values = |low: f64, high: f64| -> Vec<String> {
            let range = low.log10()..high.log10();
            ticks(&range, true, 7).iter().map(|v| number(*v, true)).collect()
        };
        assert_eq!(values(0.9, 60.0), ["1", "2", "5", "10", "20", "50"]);
        assert_eq!(values(0.0009, 1.2), ["0.001", "0.01", "0.1", "1"]);
        assert_eq!(values(61.0, 99.0), ["70", "80", "90"]);
        assert_eq!(values(1e-9, 10.0).len(), 5, "every other power");
        let text: Vec<String> = ticks(&(-3.0..103.0), false, 7).iter().map(|v| short(*v)).collect();
        assert_eq!(text, ["0", "20", "40", "60", "80", "100"]);
    }

    #[test]
    fn a_legend_stands_where_nothing_is_drawn_or_outside() {
        let mut chart = Chart {
            series: vec![Series::line("line", 0, vec![[0.0, 0.0], [1.0, 1.0]])],
            ..Chart::default()
        };
        let pixels = OnPixels {
            ranges: [0.0..1.0, 0.0..1.0],
            size: [400, 300],
        };
        assert_eq!(pixels.free(&chart, [80, 28]), Some([8, 8]));
        chart.legend = [true, false];
        assert_eq!(
            pixels.free(&chart, [80, 28]),
            Some([8, 8]),
            "the line ends in the wanted corner"
        );
        chart.series.push(Series::line("", 0, vec![[0.0, 1.0], [1.0, 0.0]]));
        assert_eq!(pixels.free(&chart, [80, 28]), Some([160, 8]), "between the corners");
        assert_eq!(pixels.free(&chart, [380, 280]), None);
    }
}
