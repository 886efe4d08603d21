//! `exposure.csv` of a dataset: true exposures and white balance.

use std::path::Path;

/// True exposure and white balance of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TrueTone {
    /// Stream index.
    pub(crate) frame: usize,
    /// Exposure, in any unit.
    pub(crate) exposure: f64,
    /// Gains of red, green and blue, where they are known.
    pub(crate) white_balance: Option<[f64; 3]>,
}

/// Reads a table by the names of its columns: `dt`, and where they are there `frame` (else rows are
/// counted), `wb_r`, `wb_g` and `wb_b`.
pub(crate) fn read_exposure_table(path: &Path) -> Result<Vec<TrueTone>, String> {
    tones(&i2slam_storage::read_text(path).map_err(|e| e.to_string())?)
}

fn tones(text: &str) -> Result<Vec<TrueTone>, String> {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').map(str::trim).collect();
    let column = |name: &str| names.iter().position(|n| *n == name);
    let exposure = column("dt").ok_or("it has no column `dt`")?;
    let [red, green, blue] = ["wb_r", "wb_g", "wb_b"].map(column);
    let rows = lines.enumerate().filter(|(_, line)| !line.trim().is_empty()).enumerate();
    let rows = rows.map(|(row, (line_before, line))| {
        let number_of_line = line_before + 2;
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let number = |i: usize| cells.get(i).and_then(|cell| cell.parse::<f64>().ok());
        let gains = || Some([number(red?)?, number(green?)?, number(blue?)?]);
        let positive = |value: &f64| value.is_finite() && *value > 0.0;
        let numbered = |i: usize| {
            let frame = cells.get(i).and_then(|cell| cell.parse().ok());
            frame.ok_or_else(|| format!("line {number_of_line} has no frame number, as 0 or 12"))
        };
        let frame = column("frame").map_or(Ok(row), numbered)?;
        let exposure = number(exposure)
            .filter(positive)
            .ok_or_else(|| format!("line {number_of_line} has no exposure above 0"))?;
        let white_balance = gains().filter(|gains| gains.iter().all(positive));
        Ok(TrueTone { frame, exposure, white_balance })
    });
    rows.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_found_by_name() {
        let text = "dt,frame,wb_r,wb_g,wb_b\n0.5,7,1.1,1.0,0.9\n\n2.0,9,1,1,1\n";
        let found = tones(text).expect("a table");
        let first = TrueTone { frame: 7, exposure: 0.5, white_balance: Some([1.1, 1.0, 0.9]) };
        assert_eq!((found.len(), found[0], found[1].frame), (2, first, 9));
        let bare = tones("dt\n1\n2\n").expect("a table");
        assert_eq!((bare[1].frame, bare[1].exposure), (1, 2.0));
        assert_eq!(bare[1].white_balance, None);
        assert!(tones("ev\n1\n").unwrap_err().contains("`dt`"));
        assert!(tones("dt\n1\n0\n").unwrap_err().contains("line 3"));
    }

    #[test]
    fn rows_are_counted_without_blank_lines_and_frames_are_whole_numbers() {
        let blank = tones("dt\n1\n\n2\n").expect("a table");
        assert_eq!((blank[1].frame, blank[1].exposure), (1, 2.0));
        assert!(tones("dt\n1\n\n0\n").unwrap_err().contains("line 4"));
        for wrong in ["-1", "2.7", ""] {
            let message = tones(&format!("frame,dt\n{wrong},1\n")).unwrap_err();
            assert!(message.contains("line 2 has no frame number"), "{message}");
        }
    }
}
