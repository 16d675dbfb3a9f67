//! Well-known text (OGC 06-103r4), as far as the service takes it: POINT, MULTIPOINT, LINESTRING and POLYGON, with Z, M or ZM.

use welkin_proto::ApiError;

/// A corner: longitude and latitude in degrees, height and measure where they are given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Longitude, latitude, degrees.
    pub longitude_latitude_deg: [f64; 2],
    /// Altitude, m.
    pub z: Option<f64>,
    /// In a trajectory: Unix seconds.
    pub m: Option<f64>,
}

/// A geometry.
#[derive(Clone, Debug, PartialEq)]
pub enum Geometry {
    /// One place.
    Point(Vertex),
    /// Places.
    MultiPoint(Vec<Vertex>),
    /// A path of two corners or more.
    LineString(Vec<Vertex>),
    /// An outer ring and holes, each closed.
    Polygon(Vec<Vec<Vertex>>),
}

struct Reader<'a> {
    text: &'a str,
    /// Which of Z and M each corner has.
    has: [bool; 2],
    corners_left: usize,
}

fn bad(why: impl Into<String>) -> ApiError {
    ApiError::new(
        "bad_coords",
        format!("not the well-known text that is taken here: {}", why.into()),
    )
    .at("/coords")
}

/// Reads a geometry of at most `corners_max` corners.
///
/// Errors: `bad_coords` for what is no such text, `too_many_points`; pointer `/coords`.
pub fn parse(text: &str, corners_max: usize) -> Result<Geometry, ApiError> {
    let mut reader = Reader {
        text: text.trim(),
        has: [false; 2],
        corners_left: corners_max,
    };
    let kind = reader.word();
    reader.has = match reader.word().as_str() {
        "" => [false, false],
        "Z" => [true, false],
        "M" => [false, true],
        "ZM" => [true, true],
        other => {
            return Err(bad(format!(
                "{other:?} stands where Z, M, ZM or a parenthesis is wanted"
            )));
        }
    };
    let (kind, has) = match kind.as_str() {
        // Some write POINTZ.
        "POINTZ" => ("POINT", [true, false]),
        "MULTIPOINTZ" => ("MULTIPOINT", [true, false]),
        "LINESTRINGZ" => ("LINESTRING", [true, false]),
        "LINESTRINGM" => ("LINESTRING", [false, true]),
        "LINESTRINGZM" => ("LINESTRING", [true, true]),
        "POLYGONZ" => ("POLYGON", [true, false]),
        other => (other, reader.has),
    };
    reader.has = has;
    let geometry = match kind {
        "POINT" => match reader.list(Reader::vertex)?.as_slice() {
            [vertex] => Geometry::Point(*vertex),
            _ => return Err(bad("a POINT has one place")),
        },
        "MULTIPOINT" => Geometry::MultiPoint(reader.list(Reader::vertex_perhaps_in_parentheses)?),
        "LINESTRING" => {
            let corners = reader.list(Reader::vertex)?;
            if corners.len() < 2 {
                return Err(bad("a LINESTRING has two corners or more"));
            }
            Geometry::LineString(corners)
        }
        "POLYGON" => {
            let rings = reader.list(|reader| reader.list(Reader::vertex))?;
            let closed = |ring: &Vec<Vertex>| ring.len() >= 4 && ring.first() == ring.last();
            if !rings.iter().all(closed) {
                return Err(bad(
                    "a ring of a POLYGON has four corners or more, the last the same as the first",
                ));
            }
            Geometry::Polygon(rings)
        }
        _ => {
            let kind: String = kind.chars().take(20).collect();
            return Err(bad(format!(
                "{kind:?} is none of POINT, MULTIPOINT, LINESTRING, POLYGON"
            )));
        }
    };
    match reader.text {
        "" => Ok(geometry),
        rest => Err(bad(format!(
            "something follows its end: {:?}",
            rest.chars().take(20).collect::<String>()
        ))),
    }
}

impl Reader<'_> {
    /// Takes the letters that come next, in upper case; empty where none do.
    fn word(&mut self) -> String {
        let end = self
            .text
            .find(|c: char| !c.is_ascii_alphabetic())
            .unwrap_or(self.text.len());
        let (word, rest) = self.text.split_at(end);
        let word = word.to_ascii_uppercase();
        self.text = rest.trim_start();
        word
    }

    fn take(&mut self, mark: char) -> bool {
        match self.text.strip_prefix(mark) {
            Some(rest) => {
                self.text = rest.trim_start();
                true
            }
            None => false,
        }
    }

    /// `( item, item, ... )`, one item at least.
    fn list<T>(&mut self, mut item: impl FnMut(&mut Self) -> Result<T, ApiError>) -> Result<Vec<T>, ApiError> {
        if !self.take('(') {
            return Err(bad("a parenthesis `(` is missing"));
        }
        let mut items = vec![item(self)?];
        while self.take(',') {
            items.push(item(self)?);
        }
        match self.take(')') {
            true => Ok(items),
            false => Err(bad("a parenthesis `)` or a comma is missing")),
        }
    }

    fn vertex_perhaps_in_parentheses(&mut self) -> Result<Vertex, ApiError> {
        if !self.take('(') {
            return self.vertex();
        }
        let vertex = self.vertex()?;
        match self.take(')') {
            true => Ok(vertex),
            false => Err(bad("a parenthesis `)` is missing")),
        }
    }

    fn vertex(&mut self) -> Result<Vertex, ApiError> {
        self.corners_left = self
            .corners_left
            .checked_sub(1)
            .ok_or_else(|| ApiError::new("too_many_points", "it has more corners than are allowed").at("/coords"))?;
        let longitude_latitude_deg = [self.number()?, self.number()?];
        let [z, m] = self.has;
        Ok(Vertex {
            longitude_latitude_deg,
            z: if z { Some(self.number()?) } else { None },
            m: if m { Some(self.number()?) } else { None },
        })
    }

    fn number(&mut self) -> Result<f64, ApiError> {
        let end = self
            .text
            .find(|c: char| c == ',' || c == '(' || c == ')' || c.is_whitespace());
        let (word, rest) = self.text.split_at(end.unwrap_or(self.text.len()));
        self.text = rest.trim_start();
        match word.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(bad(format!(
                "{:?} is no finite number",
                word.chars().take(20).collect::<String>()
            ))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_read() {
        let vertex = |x, y, z, m| Vertex {
            longitude_latitude_deg: [x, y],
            z,
            m,
        };
        for (text, geometry) in [
            ("POINT(10 45)", Geometry::Point(vertex(10.0, 45.0, None, None))),
            (
                " point  ( -1.5e1   45 ) ",
                Geometry::Point(vertex(-15.0, 45.0, None, None)),
            ),
            (
                "POINT Z (10 45 300)",
                Geometry::Point(vertex(10.0, 45.0, Some(300.0), None)),
            ),
            (
                "POINTZ(10 45 300)",
                Geometry::Point(vertex(10.0, 45.0, Some(300.0), None)),
            ),
            (
                "MULTIPOINT((1 2),(3 4))",
                Geometry::MultiPoint(vec![vertex(1.0, 2.0, None, None), vertex(3.0, 4.0, None, None)]),
            ),
            (
                "MULTIPOINT(1 2,3 4)",
                Geometry::MultiPoint(vec![vertex(1.0, 2.0, None, None), vertex(3.0, 4.0, None, None)]),
            ),
            (
                "LINESTRING ZM(1 2 3 4, 5 6 7 8)",
                Geometry::LineString(vec![
                    vertex(1.0, 2.0, Some(3.0), Some(4.0)),
                    vertex(5.0, 6.0, Some(7.0), Some(8.0)),
                ]),
            ),
            (
                "LINESTRINGM(1 2 3,4 5 6)",
                Geometry::LineString(vec![
                    vertex(1.0, 2.0, None, Some(3.0)),
                    vertex(4.0, 5.0, None, Some(6.0)),
                ]),
            ),
        ] {
            assert_eq!(parse(text, 10), Ok(geometry), "{text}");
        }
        let Ok(Geometry::Polygon(rings)) = parse("POLYGON((0 0,4 0,4 4,0 0),(1 1,2 1,2 2,1 1))", 10) else {
            panic!("a polygon");
        };
        assert_eq!(rings.iter().map(Vec::len).collect::<Vec<_>>(), [4, 4]);
    }

    #[test]
    fn every_half_of_a_text_is_refused_and_so_is_nonsense() {
        for whole in [
            "POINT Z(10 45 300)",
            "LINESTRING(1 2,3 4)",
            "POLYGON((0 0,4 0,4 4,0 0),(1 1,2 1,2 2,1 1))",
        ] {
            for end in 0..whole.len() {
                assert_eq!(parse(&whole[..end], 10).expect_err(&whole[..end]).code, "bad_coords");
            }
        }
        for text in [
            "POINT(10)",
            "POINT(10 45 300)",
            "POINT Z(10 45)",
            "POINT(NaN 45)",
            "POINT(inf 45)",
            "POINT(1e999 45)",
            "POINT(1 2, 3 4)",
            "POINT()",
            "POINT EMPTY",
            "POINT(1 2) POINT(3 4)",
            "POINT Q(1 2)",
            "CIRCLE(1 2 3)",
            "LINESTRING(1 2)",
            "POLYGON((0 0,1 0,0 0))",
            "POLYGON((0 0,1 0,1 1,0 1))",
            "POLYGON(0 0,1 0,1 1,0 0)",
            "MULTIPOINT((1 2)",
            "((((((((((((((((",
            "Ω(1 2)",
        ] {
            assert_eq!(parse(text, 10).expect_err(text).code, "bad_coords", "{text}");
        }
        let long = format!("LINESTRING({})", ["1 2"; 11].join(","));
        assert_eq!(parse(&long, 10).expect_err("long").code, "too_many_points");
    }
}
