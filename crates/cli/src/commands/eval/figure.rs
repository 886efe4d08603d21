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

impl Figure {
    /// A row of the table.
    pub(super) fn line(&self) -> String {
        let number = self.value.map(|value| format!("{value:.*}", self.decimals));
        let number = number.unwrap_or_else(|| "–".to_owned());
        format!("{:<30}{number:>9} {}", self.label, self.unit).trim_end().to_owned()
    }

    /// What is not finite (the PSNR of equal pictures) is `null`.
    pub(super) fn json(&self) -> (String, Value) {
        (self.key.to_owned(), self.value.map_or(Value::Null, Value::from))
    }
}
