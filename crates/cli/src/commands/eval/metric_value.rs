//! One value of the table and of the JSON object.

use serde_json::Value;

/// One result with its names.
#[derive(Clone, Debug)]
pub(super) struct MetricValue {
    /// Key in JSON, ending with the unit.
    pub(super) key: &'static str,
    /// Name in the table.
    pub(super) label: &'static str,
    pub(super) unit: &'static str,
    pub(super) decimals: usize,
    /// `None` if not measurable.
    pub(super) value: Option<f64>,
}

/// A line of the table.
#[derive(Clone, Debug)]
pub(super) struct TableRow {
    pub(super) name: String,
    pub(super) number: String,
    /// Unit and remark, with their separators.
    pub(super) rest: String,
}

impl TableRow {
    pub(super) fn line(&self) -> String {
        format!("{:<30}{:>9}{}", self.name, self.number, self.rest).trim_end().to_owned()
    }
}

impl MetricValue {
    /// A row of the table.
    pub(super) fn row(&self) -> TableRow {
        let number = self.value.map(|value| format!("{value:.*}", self.decimals));
        let number = number.unwrap_or_else(|| "–".to_owned());
        TableRow { name: self.label.to_owned(), number, rest: format!(" {}", self.unit) }
    }

    /// Key and value; `null` if not finite, such as the PSNR of equal pictures.
    pub(super) fn json(&self) -> (String, Value) {
        (self.key.to_owned(), self.value.map_or(Value::Null, Value::from))
    }
}
