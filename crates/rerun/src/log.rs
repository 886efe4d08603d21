//! A recording as a stream of rows of entities.

use re_build_info::CrateVersion;
use re_chunk::{Chunk, ChunkId, RowId, TimePoint};
use re_log_encoding::Encoder;
use re_log_encoding::EncodingOptions;
use re_log_types::{EntityPath, LogMsg, SetStoreInfo, StoreId, StoreInfo, StoreSource};
use re_sdk_types::archetypes::RecordingInfo;
use re_sdk_types::{AsComponents, SerializedComponentBatch};
use std::fmt::Display;
use std::io::{self, Write};

/// Name of the program in the viewer.
const APPLICATION: &str = "i2slam";

/// Writer of a recording. Its rows are numbered, not stamped, so that the same run gives the same rows; the
/// index at the end of the file has its columns in any order.
pub(crate) struct Log<'a> {
    encoder: Encoder<&'a mut dyn Write>,
    store: StoreId,
    /// Last number of a row or chunk.
    number: u128,
}

/// A row of an entity: its time, and what it has then.
pub(crate) type Row = (TimePoint, Vec<SerializedComponentBatch>);

/// A row at a time; at none it holds always.
pub(crate) fn row(time: TimePoint, parts: &[&dyn AsComponents]) -> Row {
    (time, parts.iter().flat_map(|part| part.as_serialized_batches()).collect())
}

impl<'a> Log<'a> {
    /// Begins a recording with a name for people, and one that no other has: the viewer puts recordings
    /// with the same one together.
    pub(crate) fn begin(out: &'a mut dyn Write, name: &str, identity: &str) -> io::Result<Self> {
        let options = EncodingOptions::PROTOBUF_COMPRESSED;
        let encoder = Encoder::new_eager(CrateVersion::LOCAL, options, out).map_err(failed)?;
        let store = StoreId::recording(APPLICATION, identity);
        let mut log = Self { encoder, store: store.clone(), number: 0 };
        let info = StoreInfo::new(store, StoreSource::Other(APPLICATION.to_owned()));
        let row_id = ChunkId::from_u128(log.next()).as_tuid();
        let begin = LogMsg::SetStoreInfo(SetStoreInfo { row_id, info });
        log.encoder.append(&begin).map_err(failed)?;
        let info = RecordingInfo::new().with_name(name);
        log.add(EntityPath::properties(), [row(TimePoint::STATIC, &[&info])])?;
        Ok(log)
    }

    /// Adds rows to an entity.
    pub(crate) fn add(
        &mut self,
        entity: impl Into<EntityPath>,
        rows: impl IntoIterator<Item = Row>,
    ) -> io::Result<()> {
        let mut chunk = Chunk::builder_with_id(ChunkId::from_u128(self.next()), entity);
        for (time, parts) in rows {
            chunk = chunk.with_serialized_batches(RowId::from_u128(self.next()), time, parts);
        }
        let chunk = chunk.build().and_then(|chunk| chunk.to_arrow_msg()).map_err(failed)?;
        let message = LogMsg::ArrowMsg(self.store.clone(), chunk);
        self.encoder.append(&message).map(|_| ()).map_err(failed)
    }

    /// Ends the recording.
    pub(crate) fn end(mut self) -> io::Result<()> {
        self.encoder.finish().map_err(failed)
    }

    fn next(&mut self) -> u128 {
        self.number += 1;
        self.number
    }
}

fn failed(error: impl Display) -> io::Error {
    io::Error::other(error.to_string())
}
