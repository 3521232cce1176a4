//! Rows, one at a time.

use std::io::BufRead;

use crate::PlyError;
use crate::header::{Element, Header, Kind, Scalar};
use crate::values::{NoValue, Values};

/// Most items of a list: polygons have a few.
const MAX_LIST_ITEMS: f64 = 65_536.0;

/// The numbers of one row.
#[derive(Debug, Default)]
pub struct Row {
    /// One list of numbers for each property; a scalar's has one.
    values: Vec<Vec<f64>>,
}

impl Row {
    /// The number of the property at this place; not a number if it is a list or there is none.
    #[must_use]
    pub fn value(&self, at: usize) -> f64 {
        match self.list(at) {
            [value] => *value,
            _ => f64::NAN,
        }
    }

    /// The numbers of the list at this place; empty if there is none.
    #[must_use]
    pub fn list(&self, at: usize) -> &[f64] {
        self.values.get(at).map_or(&[], Vec::as_slice)
    }
}

/// A file whose header has been read.
pub struct Reader<R> {
    header: Header,
    values: Values<R>,
    /// Elements whose rows have been read.
    done: usize,
}

impl<R: BufRead> Reader<R> {
    /// # Errors
    /// Says what is wrong with the header.
    pub fn new(mut source: R) -> Result<Self, PlyError> {
        let header = Header::read(&mut source)?;
        Ok(Self {
            values: Values::new(source, header.format),
            header,
            done: 0,
        })
    }

    /// What the file says of itself.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Gives `take` the number, from 0, and the numbers of each row of the next element, which is
    /// returned; `None` after the last.
    ///
    /// # Errors
    /// Of `take`, or if a row is cut off or holds what is no number.
    pub fn next_element<E: From<PlyError>>(
        &mut self,
        mut take: impl FnMut(&Element, u64, &Row) -> Result<(), E>,
    ) -> Result<Option<&Element>, E> {
        let Some(element) = self.header.elements.get(self.done) else {
            return Ok(None);
        };
        self.done += 1;
        let mut row = Row {
            values: vec![Vec::new(); element.properties.len()],
        };
        // Rows without a number take no bytes: any count of them may be claimed.
        let count = if row.values.is_empty() {
            0
        } else {
            element.count
        };
        for number in 0..count {
            let read = read_row(&mut self.values, element, &mut row);
            read.map_err(|why| no_row(why, element, number))?;
            take(element, number, &row)?;
        }
        Ok(Some(element))
    }
}

fn read_row<R: BufRead>(
    values: &mut Values<R>,
    element: &Element,
    row: &mut Row,
) -> Result<(), NoValue> {
    for (property, read) in element.properties.iter().zip(&mut row.values) {
        read.clear();
        match property.kind {
            Kind::Scalar(scalar) => read.push(values.next(scalar)?),
            Kind::List { count, item } => {
                for _ in 0..list_length(values, count)? {
                    read.push(values.next(item)?);
                }
            }
        }
    }
    Ok(values.end_row()?)
}

fn list_length<R: BufRead>(values: &mut Values<R>, count: Scalar) -> Result<usize, NoValue> {
    let count = values.next(count)?;
    if !(0.0..=MAX_LIST_ITEMS).contains(&count) {
        return Err(NoValue::Wrong(format!(
            "a list claims {count} items; at most {MAX_LIST_ITEMS} are taken"
        )));
    }
    Ok(count as usize)
}

fn no_row(why: NoValue, element: &Element, row: u64) -> PlyError {
    let name = element.name.clone();
    match why {
        NoValue::Ended => PlyError::Cut {
            element: name,
            expected: element.count,
            found: row,
        },
        NoValue::Wrong(what) => PlyError::Row {
            element: name,
            row,
            what,
        },
        NoValue::Io(error) => PlyError::Io(error),
    }
}
