//! One number of the table and of the JSON object.

use serde_json::Value;

/// A number with its names.
#[derive(Clone, Debug)]
pub(super) struct Figure {
    /// In JSON; ends with the unit.
    pub(super) key: &'static str,
    /// In the table.
    pub(super) label: &'static str,
    pub(super) unit: &'static str,
    pub(super) decimals: usize,
    /// `None` if it cannot be measured.
    pub(super) value: Option<f64>,
}

/// A line of the table, in its parts.
#[derive(Clone, Debug)]
pub(super) struct Row {
    pub(super) name: String,
    pub(super) number: String,
    /// Unit and remark, with what parts them from the number.
    pub(super) rest: String,
}

impl Row {
    pub(super) fn line(&self) -> String {
        format!("{:<30}{:>9}{}", self.name, self.number, self.rest).trim_end().to_owned()
    }
}

impl Figure {
    /// A row of the table.
    pub(super) fn row(&self) -> Row {
        let number = self.value.map(|value| format!("{value:.*}", self.decimals));
        let number = number.unwrap_or_else(|| "–".to_owned());
        Row { name: self.label.to_owned(), number, rest: format!(" {}", self.unit) }
    }

    /// What is not finite (the PSNR of equal pictures) is `null`.
    pub(super) fn json(&self) -> (String, Value) {
        (self.key.to_owned(), self.value.map_or(Value::Null, Value::from))
    }
}
