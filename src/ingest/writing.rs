//! From the threads that encode to the one that writes.

use super::IngestError;
use super::progress::Progress;
use super::queue::Queue;
use crate::store::model::{NodeHead, Zones};
use crate::store::{EncodedNode, StoreError, Writer};

/// Takes encoded nodes, from any thread. Their rows are numbered when they are written.
pub(super) type Sink<'a> = &'a (dyn Fn(EncodedNode) -> Result<(), IngestError> + Sync);

/// What was written: rows that count once they are committed.
#[derive(Debug, Default)]
pub(super) struct Written {
    /// In the order of their writing.
    pub nodes: Vec<(NodeHead, Zones)>,
    /// Chunk rows.
    pub chunks: u64,
}

/// Runs `encode`, whose nodes are written as they come by a thread of its own; so many bytes of them may wait.
pub(super) fn through<R>(
    writer: &mut Writer,
    queue_bytes: usize,
    progress: &dyn Progress,
    encode: impl FnOnce(Sink<'_>) -> Result<R, IngestError>,
) -> Result<(R, Written), IngestError> {
    let queue = Queue::new(queue_bytes);
    let ids = writer.chunk_ids();
    std::thread::scope(|scope| {
        let writing = scope.spawn(|| {
            let _leaves = queue.leaves();
            let mut written = Written::default();
            while let Some(mut node) = queue.pop() {
                node.renumber(&ids);
                writer.put_chunks_unless(&node.chunks, &|| progress.cancelled())?;
                written.chunks += node.chunks.len() as u64;
                written.nodes.push((node.head, node.zones));
            }
            Ok::<_, StoreError>(written)
        });
        let ends = queue.ends();
        // The writer only stops taking when it has failed, and says why when it is joined.
        let sink = |node| {
            let taken = queue.push(node);
            taken.then_some(()).ok_or_else(|| IngestError::Internal("the writer has stopped".into()))
        };
        let encoded = encode(&sink);
        drop(ends);
        let written = writing.join().map_err(|_| IngestError::Internal("the writer broke down".into()))?;
        match (encoded, written) {
            // Whoever is told to stop waits for no reader.
            (_, Err(_)) if progress.cancelled() => Err(IngestError::Interrupted),
            (_, Err(error)) => Err(error.into()),
            (Err(error), Ok(_)) => Err(error),
            (Ok(result), Ok(written)) => Ok((result, written)),
        }
    })
}
