//! From the threads that encode to the one that writes.

use super::IngestError;
use crate::store::model::{NodeHead, Zones};
use crate::store::{EncodedNode, StoreError, Writer};
use std::sync::mpsc::sync_channel;

/// Takes encoded nodes, from any thread.
pub(super) type Sink<'a> = &'a (dyn Fn(EncodedNode) -> Result<(), IngestError> + Sync);

/// What was written: rows that count once they are committed.
#[derive(Debug, Default)]
pub(super) struct Written {
    /// In the order of their writing.
    pub nodes: Vec<(NodeHead, Zones)>,
    /// Chunk rows.
    pub chunks: u64,
}

/// Runs `encode`, whose nodes are written as they come by a thread of its own; `queue` of them may wait.
pub(super) fn through<R>(
    writer: &mut Writer,
    queue: usize,
    encode: impl FnOnce(Sink<'_>) -> Result<R, IngestError>,
) -> Result<(R, Written), IngestError> {
    let (sender, receiver) = sync_channel::<EncodedNode>(queue);
    std::thread::scope(|scope| {
        let writing = scope.spawn(move || {
            let mut written = Written::default();
            for node in receiver {
                writer.put_chunks(&node.chunks)?;
                written.chunks += node.chunks.len() as u64;
                written.nodes.push((node.head, node.zones));
            }
            Ok::<_, StoreError>(written)
        });
        // The writer only stops listening when it has failed, and says why when it is joined.
        let sink = |node| sender.send(node).map_err(|_| IngestError::Internal("the writer has stopped".into()));
        let encoded = encode(&sink);
        drop(sender);
        let written = writing.join().map_err(|_| IngestError::Internal("the writer broke down".into()))?;
        match (encoded, written) {
            (_, Err(error)) => Err(error.into()),
            (Err(error), Ok(_)) => Err(error),
            (Ok(result), Ok(written)) => Ok((result, written)),
        }
    })
}
