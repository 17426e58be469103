//! Which point is under a pixel: ids that the passes write are looked up in the frame's own table.

use crate::lattice::Cube;
use crate::stream::gpu::{DrawBlock, DrawNode};

/// A point of the store, as the picture knows it: the caller reads it with all its attributes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Picked {
    /// Its node's cube.
    pub cube: Cube,
    /// Its node's layer.
    pub layer: u16,
    /// The node's part.
    pub part: u32,
    /// Which point of the part, in the part's own order.
    pub index: u32,
    /// The pixel of the image that shows it: the nearest to the one asked for.
    pub pixel: [u32; 2],
}

/// Who the ids of a frame are: runs, ascending by their first id.
#[derive(Clone, Debug, Default)]
pub(super) struct PickTable {
    runs: Vec<PickRun>,
}

#[derive(Clone, Copy, Debug)]
struct PickRun {
    first_id: u32,
    points: u32,
    cube: Cube,
    layer: u16,
    part: u32,
    first: u32,
}

impl PickTable {
    pub fn push(&mut self, first_id: u32, node: &DrawNode, block: &DrawBlock) {
        let (cube, layer, part, first) = (node.cube, node.layer, block.part, block.first);
        self.runs.push(PickRun { first_id, points: block.points, cube, layer, part, first });
    }

    /// The point of an id; `None` for 0, which is nobody's.
    pub fn resolve(&self, id: u32, pixel: [u32; 2]) -> Option<Picked> {
        let run = self.runs[..self.runs.partition_point(|run| run.first_id <= id)].last()?;
        let index = id - run.first_id;
        let (cube, layer, part) = (run.cube, run.layer, run.part);
        (index < run.points).then(|| Picked { cube, layer, part, index: run.first + index, pixel })
    }
}

/// A look at a small square of a frame's ids, on its way back from the adapter.
///
/// Asked for by [`Renderer::request_pick`](super::Renderer::request_pick); it keeps the table of its own frame, so later
/// frames don't change what it finds.
#[derive(Debug)]
pub struct PickRequest {
    pub(super) buffer: wgpu::Buffer,
    pub(super) table: PickTable,
    /// The square's first pixel, its size, and the pixel asked for.
    pub(super) low: [u32; 2],
    pub(super) size: [u32; 2],
    pub(super) wanted: [u32; 2],
    pub(super) arrived: Option<std::sync::mpsc::Receiver<Result<(), wgpu::BufferAsyncError>>>,
}

impl PickRequest {
    /// Begins to fetch the ids: to be called when the commands of the request are submitted.
    pub fn submitted(&mut self) {
        let (sender, receiver) = std::sync::mpsc::channel();
        self.buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            // Nobody may be interested any more.
            let _ = sender.send(result);
        });
        self.arrived = Some(receiver);
    }

    /// What was found, once it is there: `None` until then, `Some(None)` if no point is near the pixel. Never waits; the
    /// device must be polled by whoever owns the frames, as wgpu's `Queue::submit` does.
    pub fn poll(&mut self) -> Option<Option<Picked>> {
        match self.arrived.as_ref()?.try_recv() {
            Err(std::sync::mpsc::TryRecvError::Empty) => None,
            Ok(Ok(())) => {
                self.arrived = None;
                Some(self.nearest())
            }
            Ok(Err(_)) | Err(std::sync::mpsc::TryRecvError::Disconnected) => {
                self.arrived = None;
                Some(None)
            }
        }
    }

    fn nearest(&self) -> Option<Picked> {
        let bytes = self.buffer.get_mapped_range(..).ok()?;
        let row_bytes = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize;
        let mut best: Option<(u64, u32, [u32; 2])> = None;
        for (y, row) in (self.low[1]..).zip(bytes.chunks(row_bytes)).take(self.size[1] as usize) {
            for (x, id) in (self.low[0]..).zip(row.chunks_exact(4)).take(self.size[0] as usize) {
                let id = u32::from_le_bytes([id[0], id[1], id[2], id[3]]);
                let away = |a: u32, b: u32| u64::from(a.abs_diff(b)).pow(2);
                let distance = away(x, self.wanted[0]) + away(y, self.wanted[1]);
                if id != 0 && best.is_none_or(|(least, ..)| distance < least) {
                    best = Some((distance, id, [x, y]));
                }
            }
        }
        let (_, id, pixel) = best?;
        self.table.resolve(id, pixel)
    }
}
