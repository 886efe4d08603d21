//! Lines between the program and its workers.

use crate::case::CaseId;
use crate::failure::{Failure, Outcome, find_fault};

/// Beginning of an answer, which no library prints.
const MARK: char = '\u{1}';

/// A reader and a case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Request<'a> {
    pub(crate) reader: &'a str,
    pub(crate) id: CaseId,
}

/// Outcome of a case, with time and memory.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Answer {
    pub(crate) outcome: Outcome,
    /// Time of reading [s].
    pub(crate) seconds: f64,
    /// Most memory taken beyond that before [bytes].
    pub(crate) memory: u64,
}

impl<'a> Request<'a> {
    pub(crate) fn line(&self) -> String {
        match self.id {
            CaseId::Seed(index) => format!("{} seed {index}\n", self.reader),
            CaseId::Number(number) => format!("{} case {number}\n", self.reader),
        }
    }

    pub(crate) fn parse(line: &'a str) -> Option<Self> {
        let mut words = line.split_whitespace();
        let (reader, kind) = (words.next()?, words.next()?);
        let number = words.next()?.parse::<u64>().ok()?;
        let id = match kind {
            "seed" => CaseId::Seed(usize::try_from(number).ok()?),
            _ => CaseId::Number(number),
        };
        Some(Self { reader, id })
    }
}

impl Answer {
    pub(crate) fn line(&self) -> String {
        let (kind, message) = match &self.outcome {
            Outcome::Accepted => ("accepted", String::new()),
            Outcome::Refused(message) => ("refused", message.clone()),
            Outcome::Failed(Failure::Panic(message)) => ("panic", message.clone()),
            Outcome::Failed(Failure::Message(fault, message)) => (*fault, message.clone()),
            Outcome::Failed(other) => ("panic", other.to_string()),
        };
        let message = message.replace('\n', "\u{2}");
        format!("{MARK}{kind}\t{}\t{}\t{message}\n", self.seconds, self.memory)
    }

    /// Parses a line; `None` if it is no answer.
    pub(crate) fn parse(line: &str) -> Option<Self> {
        let mut fields = line.strip_prefix(MARK)?.splitn(4, '\t');
        let kind = fields.next()?;
        let (seconds, memory) = (fields.next()?.parse().ok()?, fields.next()?.parse().ok()?);
        let message = fields.next()?.trim_end_matches('\n').replace('\u{2}', "\n");
        let outcome = match kind {
            "accepted" => Outcome::Accepted,
            "refused" => Outcome::Refused(message),
            "panic" => Outcome::Failed(Failure::Panic(message)),
            fault => Outcome::Failed(Failure::Message(find_fault(fault)?, message)),
        };
        Some(Self { outcome, seconds, memory })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_as_they_were_written() {
        for id in [CaseId::Seed(3), CaseId::Number(u64::MAX)] {
            let request = Request { reader: "tum", id };
            assert_eq!(Request::parse(&request.line()), Some(request));
        }
        for outcome in [
            Outcome::Accepted,
            Outcome::Refused("two\nlines\tand a tab".into()),
            Outcome::Failed(Failure::Panic("at once".into())),
            Outcome::Failed(Failure::Message("names no file", "no".into())),
            Outcome::Failed(Failure::Message("shows the insides of an error", "Os {".into())),
        ] {
            let answer = Answer { outcome, seconds: 0.25, memory: 77 };
            assert_eq!(answer.line().matches('\n').count(), 1);
            assert_eq!(Answer::parse(&answer.line()), Some(answer));
        }
        assert_eq!(Answer::parse("a library prints\n"), None);
    }
}
