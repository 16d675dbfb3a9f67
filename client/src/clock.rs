//! The server's clock as a client sees it, and playing volumes by it: PROTOCOL.md, "Time".

use std::collections::VecDeque;
use std::sync::Arc;

use welkin_proto::volume::VolumeField;

/// Answers to pings, and messages, that are remembered.
const REMEMBERED: usize = 16;
/// Messages that the delay is made of.
const SPACINGS: usize = 32;
/// The delay changes by at most this share of the time that goes by, so that the sky neither jumps nor stands.
const SLEW: f64 = 0.1;
/// A delay that is further off, s, is taken at once: after a world has stood.
const JUMP_S: f64 = 2.0;
/// A time between publications that is so many times the median is one in which the world stood, and does not count.
const STOOD: f64 = 4.0;
/// Fields that are kept to be played.
const FIELDS_MAX: usize = 64;

/// Guesses the server's clock from pings: of the last sixteen, the one with the shortest way there and back is believed.
#[derive(Clone, Debug, Default)]
pub struct Clock {
    /// Way there and back, and offset of the server's clock to ours, s.
    answers: VecDeque<(f64, f64)>,
}

impl Clock {
    /// Notes the answer to a ping: when it went and came by our clock, and what the server's said in between, s. What makes no sense is ignored.
    pub fn answered(&mut self, sent_s: f64, received_s: f64, server_unix_s: f64) {
        let way_s = received_s - sent_s;
        if !(way_s >= 0.0 && server_unix_s.is_finite() && received_s.is_finite()) {
            return;
        }
        if self.answers.len() == REMEMBERED {
            self.answers.pop_front();
        }
        self.answers
            .push_back((way_s, server_unix_s - 0.5 * (sent_s + received_s)));
    }

    fn best(&self) -> Option<(f64, f64)> {
        self.answers.iter().copied().min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// What the server's clock says when ours says `now_s`, Unix seconds; none before the first answer.
    pub fn server_unix_s(&self, now_s: f64) -> Option<f64> {
        self.best().map(|(_, offset_s)| now_s + offset_s)
    }

    /// Largest error of [`Clock::server_unix_s`], s, where clocks run alike: half of the shortest way there and back.
    pub fn error_max_s(&self) -> Option<f64> {
        self.best().map(|(way_s, _)| 0.5 * way_s)
    }
}

/// How far behind the server's clock a client plays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Delay {
    /// As far as the messages of late need to be there in time.
    Adaptive,
    /// So many seconds: for clients that are to be in step.
    Fixed(f64),
}

/// Fields in the order of their publication, to be shown smoothly a little later.
#[derive(Clone, Debug)]
pub struct Playout {
    delay: Delay,
    adapted_s: f64,
    last_shown_s: Option<f64>,
    fields: VecDeque<Arc<VolumeField>>,
    /// Time from the publication before to this one, and from publication to arrival, s.
    spacings: VecDeque<(f64, f64)>,
}

/// What is to be shown at a moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// The newest field that is not after the moment; or the oldest there is.
    pub before: Arc<VolumeField>,
    /// The one after it, and its weight, 0 to 1.
    pub after: Option<(Arc<VolumeField>, f32)>,
    /// The simulated second that is shown.
    pub simulated_s: f64,
}

impl Shown {
    fn mix(&self, of: impl Fn(&VolumeField) -> Option<f32>) -> Option<f32> {
        let before = of(&self.before)?;
        match &self.after {
            None => Some(before),
            Some((after, weight)) => Some((1.0 - weight) * before + weight * of(after)?),
        }
    }

    /// A channel's value at a place, m from the world's south-west corner on the ground: of the cell that holds it.
    pub fn value_at(&self, channel: &str, position_m: [f64; 3]) -> Option<f32> {
        self.mix(|field| field.value_at(channel, position_m))
    }

    /// A channel's values, `[z][y][x]`.
    pub fn values(&self, channel: &str) -> Option<Vec<f32>> {
        let mut values = self.before.channel(channel)?.values();
        if let Some((after, weight)) = &self.after {
            for (value, after) in values.iter_mut().zip(after.channel(channel)?.values()) {
                *value = (1.0 - weight) * *value + weight * after;
            }
        }
        Some(values)
    }
}

impl Playout {
    /// Nothing to play yet.
    pub fn new(delay: Delay) -> Self {
        Self {
            delay,
            adapted_s: 0.0,
            last_shown_s: None,
            fields: VecDeque::new(),
            spacings: VecDeque::new(),
        }
    }

    /// Takes a field that arrived when the server's clock said `arrived_unix_s`. One of another shape begins anew; one that is not newer is dropped.
    pub fn push(&mut self, field: Arc<VolumeField>, arrived_unix_s: f64) {
        let same_shape = |last: &Arc<VolumeField>| {
            let names = |f: &VolumeField| f.channels.iter().map(|c| c.name.clone()).collect::<Vec<_>>();
            last.layout == field.layout && names(last) == names(&field)
        };
        if self.fields.back().is_some_and(|last| !same_shape(last)) {
            self.fields.clear();
            self.spacings.clear();
        }
        let published_s = field.moment.published_unix_s;
        if let Some(last) = self.fields.back() {
            let spacing_s = published_s - last.moment.published_unix_s;
            if spacing_s <= 0.0 {
                return;
            }
            if self.spacings.len() == SPACINGS {
                self.spacings.pop_front();
            }
            self.spacings.push_back((spacing_s, arrived_unix_s - published_s));
        }
        if self.fields.len() == FIELDS_MAX {
            self.fields.pop_front();
        }
        self.fields.push_back(field);
    }

    /// How far behind the server's clock is played now, s.
    pub fn delay_s(&self) -> f64 {
        match self.delay {
            Delay::Fixed(delay_s) => delay_s,
            Delay::Adaptive => self.adapted_s,
        }
    }

    fn adapt(&mut self, now_s: f64) {
        let mut between: Vec<f64> = self.spacings.iter().map(|s| s.0).collect();
        between.sort_by(f64::total_cmp);
        let median = between.get(between.len().saturating_sub(1) / 2).copied();
        let counts = |s: &&f64| median.is_some_and(|median| **s <= STOOD * median);
        let longest_s = between.iter().rfind(counts).copied().unwrap_or(0.0);
        let target_s = longest_s + self.spacings.iter().map(|s| s.1).fold(0.0, f64::max);
        self.adapted_s = match self.last_shown_s {
            // Until there are two fields nothing moves yet, and any delay may be taken at once.
            Some(last_s) if self.adapted_s > 0.0 && (target_s - self.adapted_s).abs() <= JUMP_S => {
                let most_s = SLEW * (now_s - last_s).max(0.0);
                self.adapted_s + (target_s - self.adapted_s).clamp(-most_s, most_s)
            }
            _ => target_s,
        };
        self.last_shown_s = Some(now_s);
    }

    /// What to show when the server's clock says `server_unix_s`; none before the first field. Fields that are over are forgotten.
    pub fn at(&mut self, server_unix_s: f64) -> Option<Shown> {
        self.adapt(server_unix_s);
        let shown_s = server_unix_s - self.delay_s();
        while self
            .fields
            .get(1)
            .is_some_and(|next| next.moment.published_unix_s <= shown_s)
        {
            self.fields.pop_front();
        }
        let before = Arc::clone(self.fields.front()?);
        let moment = before.moment;
        let after = self.fields.get(1).filter(|_| moment.published_unix_s <= shown_s);
        let Some(after) = after else {
            return Some(Shown {
                simulated_s: moment.simulated_s,
                before,
                after: None,
            });
        };
        let spacing_s = after.moment.published_unix_s - moment.published_unix_s;
        let weight = ((shown_s - moment.published_unix_s) / spacing_s).clamp(0.0, 1.0);
        Some(Shown {
            simulated_s: (1.0 - weight) * moment.simulated_s + weight * after.moment.simulated_s,
            after: Some((Arc::clone(after), weight as f32)),
            before,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use welkin_proto::volume::{Bits, Compression, Curve, Encoder, Layout, Moment, Plane, Receiver, Region, Taken};

    /// Fields of one cell that hold their number.
    fn fields(published_s: &[f64]) -> Vec<Arc<VolumeField>> {
        let layout = Layout {
            world_cells: [1; 3],
            cell_size_m: [10.0; 3],
            region: Region::whole([1; 3]),
            mip: 0,
            brick: [8; 3],
        };
        let plane = Plane {
            name: "wind_x_m_s".to_owned(),
            curve: Curve::Linear,
        };
        let mut encoder =
            Encoder::new(1, layout, vec![plane], Bits::Sixteen, Compression::None).expect("a layout of one cell");
        let mut receiver = Receiver::default();
        let field = |(n, at): (usize, &f64)| {
            let moment = Moment {
                simulated_s: 8.0 * at,
                published_unix_s: *at,
                ..Moment::default()
            };
            let (_, message) = encoder.encode(&moment, &[&[n as f32]]).expect("it fits");
            match receiver.take(&message) {
                Ok(Taken::Field(field)) => field,
                other => panic!("{other:?}"),
            }
        };
        published_s.iter().enumerate().map(field).collect()
    }

    #[test]
    fn the_clock_believes_the_shortest_way() {
        let mut clock = Clock::default();
        assert_eq!(clock.server_unix_s(0.0), None);
        // The server is 1000 s ahead; the way there takes 1 ms, the way back far longer and every time differently.
        for n in 0..40 {
            let sent_s = f64::from(n);
            let back_s = 0.001 + 0.05 * f64::from((n * 7) % 5);
            clock.answered(sent_s, sent_s + 0.001 + back_s, sent_s + 0.001 + 1000.0);
        }
        let error_s = clock.server_unix_s(50.0).expect("it was answered") - 1050.0;
        assert!(error_s.abs() <= clock.error_max_s().expect("it was answered") + 1e-9);
        assert!(error_s.abs() < 1e-6, "{error_s}");
        for (sent_s, received_s, server_s) in [(5.0, 4.0, 0.0), (f64::NAN, 1.0, 1.0), (0.0, 1.0, f64::INFINITY)] {
            let before = clock.clone();
            clock.answered(sent_s, received_s, server_s);
            assert_eq!(clock.answers, before.answers);
        }
    }

    #[test]
    fn between_two_fields_their_mean_by_time_is_shown() {
        let mut playout = Playout::new(Delay::Fixed(1.0));
        assert_eq!(playout.at(100.0), None);
        for field in fields(&[100.0, 100.5, 101.5]) {
            playout.push(field, 101.6);
        }
        let at = |playout: &mut Playout, s: f64| {
            let shown = playout.at(s).expect("there are fields");
            (
                shown.value_at("wind_x_m_s", [5.0; 3]).expect("a cell"),
                shown.simulated_s,
            )
        };
        assert_eq!(at(&mut playout, 100.0), (0.0, 800.0), "before the first, the first");
        assert_eq!(at(&mut playout, 101.25), (0.5, 802.0));
        assert_eq!(at(&mut playout, 101.5), (1.0, 804.0));
        assert_eq!(at(&mut playout, 102.25), (1.75, 810.0));
        assert_eq!(at(&mut playout, 109.0), (2.0, 812.0), "after the last, the last");
    }

    #[test]
    fn a_world_that_stood_does_not_hold_the_sky_back() {
        // Somebody comes while the world stands; after twenty seconds it goes on twice a second, and later stands again.
        let mut times = vec![100.0];
        times.extend((0..10).map(|n| 120.0 + 0.5 * f64::from(n)));
        times.extend((0..10).map(|n| 150.0 + 0.5 * f64::from(n)));
        let mut playout = Playout::new(Delay::Adaptive);
        for (n, field) in fields(&times).into_iter().enumerate() {
            playout.push(field, times[n] + 0.1);
            playout.at(times[n] + 0.1);
            let most_s = if n < 2 { 20.2 } else { 0.7 };
            assert!(playout.delay_s() <= most_s, "{} s at message {n}", playout.delay_s());
        }
        assert!((playout.delay_s() - 0.6).abs() < 0.05, "{}", playout.delay_s());
    }

    #[test]
    fn the_delay_grows_with_what_arrives_late_and_moves_slowly() {
        let mut playout = Playout::new(Delay::Adaptive);
        let times: Vec<f64> = (0..40).map(|n| 100.0 + 0.5 * f64::from(n)).collect();
        let fields = fields(&times);
        for (n, field) in fields.iter().enumerate().take(8) {
            playout.push(Arc::clone(field), times[n] + 0.1);
        }
        playout.at(104.0);
        assert!((playout.delay_s() - 0.6).abs() < 1e-9, "{}", playout.delay_s());
        // From now on messages take 0.4 s: the delay follows to 0.9 s, by no more than a tenth of the time that goes by.
        let mut last = (104.0, playout.delay_s());
        for n in 8..40 {
            playout.push(Arc::clone(&fields[n]), times[n] + 0.4);
            let now_s = times[n] + 0.4;
            playout.at(now_s);
            let (moved_s, went_by_s) = ((playout.delay_s() - last.1).abs(), now_s - last.0);
            assert!(moved_s <= 0.1 * went_by_s + 1e-9, "{moved_s} in {went_by_s}");
            last = (now_s, playout.delay_s());
        }
        assert!((playout.delay_s() - 0.9).abs() < 1e-9, "{}", playout.delay_s());
    }
}
