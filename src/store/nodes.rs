//! The tree of a snapshot, loaded where it is looked at.
//!
//! Rows are loaded by pages: of a small node all that lies below it, which is one range of keys; of a larger one its
//! children. A page is checked against the row above it when it is loaded: every child that a node names is there and no
//! other, and counts and bounds of a subtree are those of its parts. Pages that nobody has asked for lately are
//! forgotten; whoever holds a [`Node`] keeps its page.

use super::error::{RowError, StoreError};
use super::index::NodeIx;
use super::model::{NodeHead, PartHead, Zones};
use super::rows::{self, SiteRow};
use super::snapshot::Snapshot;
use super::tree_check::{Checker, Sum, check_alone, damage};
use crate::lattice::Cube;
use rusqlite::Connection;
use std::collections::HashMap;
use std::ops::{Deref, Range};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock, PoisonError, RwLock};

/// Nodes with at most as many points as so many full leaves have all that lies below them in one page: some tens of
/// rows.
const PAGE_LEAVES: u64 = 32;

/// A node of a snapshot: what its row says, and where it is in the tree. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Node {
    page: Arc<Page>,
    at: u32,
}

impl Deref for Node {
    type Target = NodeHead;

    fn deref(&self) -> &NodeHead {
        &self.page.heads[self.at as usize]
    }
}

impl Node {
    /// Its number: by layer and within a layer in pre-order, from 0.
    pub fn ix(&self) -> NodeIx {
        self.page.numbers[self.at as usize]
    }

    /// The numbers of the node and of all below it.
    pub fn subtree(&self) -> Range<NodeIx> {
        self.ix()..self.ix() + self.subtree_nodes as NodeIx
    }

    /// Is it the root of its layer?
    pub fn is_root(&self) -> bool {
        self.page.roots[self.at as usize]
    }
}

/// Some rows that were loaded together.
#[derive(Debug)]
struct Page {
    heads: Vec<NodeHead>,
    numbers: Vec<NodeIx>,
    roots: Vec<bool>,
    zones: Vec<OnceLock<Arc<Zones>>>,
    /// All that lies below its nodes is here, too.
    is_deep: bool,
    bytes: usize,
    /// When it was last asked for, by the cache's clock.
    used: AtomicU64,
}

impl Page {
    /// Rows in pre-order, the first of which has number `first`.
    fn deep(heads: Vec<NodeHead>, roots: Vec<bool>, first: NodeIx) -> Self {
        Self::new(true, (first..).take(heads.len()).collect(), roots, heads)
    }

    /// Siblings, the first of which has number `first`.
    fn family(heads: Vec<NodeHead>, are_roots: bool, first: NodeIx) -> Self {
        let mut next = first;
        let number = |head: &NodeHead| {
            let number = next;
            next = next.saturating_add(head.subtree_nodes as NodeIx);
            number
        };
        Self::new(false, heads.iter().map(number).collect(), vec![are_roots; heads.len()], heads)
    }

    fn new(is_deep: bool, numbers: Vec<NodeIx>, roots: Vec<bool>, heads: Vec<NodeHead>) -> Self {
        let bytes = heads.iter().map(bytes_of).sum();
        let zones = heads.iter().map(|_| OnceLock::new()).collect();
        Self { heads, numbers, roots, zones, is_deep, bytes, used: AtomicU64::new(0) }
    }
}

/// What a row takes in memory, its place in a page included, roughly.
fn bytes_of(head: &NodeHead) -> usize {
    let part = |p: &PartHead| size_of::<PartHead>() + 8 * (p.chunks.len() + p.packed.len());
    let zones = size_of::<OnceLock<Arc<Zones>>>();
    size_of::<NodeHead>() + 24 * head.scans.len() + head.parts.iter().map(part).sum::<usize>() + zones + 8
}

/// The pages of one snapshot.
#[derive(Debug, Default)]
pub(super) struct Pages {
    /// How many bytes of them are kept.
    limit: usize,
    roots: OnceLock<Arc<Page>>,
    /// By the number of the node whose children they hold.
    below: RwLock<HashMap<NodeIx, Arc<Page>>>,
    bytes: AtomicUsize,
    clock: AtomicU64,
    loads: AtomicU64,
}

impl Pages {
    /// None are loaded yet.
    pub fn new(limit: usize) -> Self {
        Self { limit, ..Self::default() }
    }

    /// Of a tree that is all there, with its zone maps: nothing is ever loaded.
    pub fn whole(heads: Vec<NodeHead>, parents: impl Iterator<Item = bool>, zones: Vec<Zones>) -> Self {
        let mut page = Page::deep(heads, parents.collect(), 0);
        page.zones = zones.into_iter().map(|z| OnceLock::from(Arc::new(z))).collect();
        Self { roots: OnceLock::from(Arc::new(page)), ..Self::default() }
    }

    fn find(&self, parent: NodeIx) -> Option<Arc<Page>> {
        let pages = self.below.read().unwrap_or_else(PoisonError::into_inner);
        let page = pages.get(&parent)?;
        page.used.store(self.clock.fetch_add(1, Ordering::Relaxed), Ordering::Relaxed);
        Some(page.clone())
    }

    /// Keeps a page; another thread may have been faster.
    fn keep(&self, parent: NodeIx, page: Page) -> Arc<Page> {
        self.loads.fetch_add(1, Ordering::Relaxed);
        page.used.store(self.clock.fetch_add(1, Ordering::Relaxed), Ordering::Relaxed);
        let mut pages = self.below.write().unwrap_or_else(PoisonError::into_inner);
        if let Some(there) = pages.get(&parent) {
            return there.clone();
        }
        let page = Arc::new(page);
        let bytes = self.bytes.fetch_add(page.bytes, Ordering::Relaxed) + page.bytes;
        pages.insert(parent, page.clone());
        if bytes > self.limit {
            self.forget(&mut pages, self.limit / 4 * 3);
        }
        page
    }

    /// Lets go of the pages that were not asked for the longest, until at most so many bytes are left.
    fn forget(&self, pages: &mut HashMap<NodeIx, Arc<Page>>, left: usize) {
        let mut by_age: Vec<(u64, NodeIx)> =
            pages.iter().map(|(&parent, page)| (page.used.load(Ordering::Relaxed), parent)).collect();
        by_age.sort_unstable();
        for (_, parent) in by_age {
            if self.bytes.load(Ordering::Relaxed) <= left {
                return;
            }
            if let Some(page) = pages.remove(&parent) {
                self.bytes.fetch_sub(page.bytes, Ordering::Relaxed);
            }
        }
    }
}

/// The nodes of a snapshot. Cheap to clone; may be used from several threads at once.
#[derive(Clone, Debug)]
pub struct Nodes {
    snapshot: Snapshot,
}

impl Nodes {
    pub(super) fn of(snapshot: Snapshot) -> Self {
        Self { snapshot }
    }

    fn pages(&self) -> &Pages {
        self.snapshot.pages()
    }

    /// The number of nodes.
    pub fn len(&self) -> u64 {
        self.snapshot.site_row().nodes
    }

    /// No nodes?
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The number of layers, empty ones included.
    pub fn layers(&self) -> u16 {
        self.snapshot.site().roots.len() as u16
    }

    /// How often rows were loaded, and bytes of rows in memory.
    pub fn loaded(&self) -> (u64, usize) {
        let pages = self.pages();
        (pages.loads.load(Ordering::Relaxed), pages.bytes.load(Ordering::Relaxed))
    }

    /// The roots of all layers that have one, by layer.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if a row is missing or wrong.
    pub fn roots(&self) -> Result<Vec<Node>, StoreError> {
        let pages = self.pages();
        let page = match pages.roots.get() {
            Some(page) => page,
            None => {
                let page = self.snapshot.with(|c| load_roots(c, self.snapshot.site_row()))?;
                pages.roots.get_or_init(|| Arc::new(page))
            }
        };
        let roots = (0..page.heads.len() as u32).filter(|&at| page.roots[at as usize]);
        Ok(roots.map(|at| Node { page: page.clone(), at }).collect())
    }

    /// The root of a layer.
    ///
    /// # Errors
    ///
    /// As [`Nodes::roots`].
    pub fn root(&self, layer: u16) -> Result<Option<Node>, StoreError> {
        Ok(self.roots()?.into_iter().find(|root| root.layer == layer))
    }

    /// The children in octant order.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if the row of one, or of a node that was loaded with them, is missing or wrong.
    pub fn children(&self, node: &Node) -> Result<Children, StoreError> {
        if node.children == 0 {
            return Ok(Children { page: node.page.clone(), next: 0, left: 0 });
        }
        let left = node.children.count_ones();
        if node.page.is_deep {
            return Ok(Children { page: node.page.clone(), next: node.at + 1, left });
        }
        let ix = node.ix();
        let page = match self.pages().find(ix) {
            Some(page) => page,
            None => {
                let page = self.snapshot.with(|c| load_below(c, self.snapshot.site_row(), node))?;
                self.pages().keep(ix, page)
            }
        };
        // A deep page begins with the parent.
        Ok(Children { next: u32::from(page.is_deep), page, left })
    }

    /// The node with a number below [`Nodes::len`].
    ///
    /// # Errors
    ///
    /// As [`Nodes::children`], for the nodes above it; also if there is no such node.
    pub fn node(&self, ix: NodeIx) -> Result<Node, StoreError> {
        let missing = || StoreError::Inconsistent {
            path: self.snapshot.place().path().into(),
            what: format!("there is no node {ix}"),
        };
        let mut node = self.roots()?.into_iter().find(|root| root.subtree().contains(&ix)).ok_or_else(missing)?;
        while node.ix() != ix {
            if node.page.is_deep {
                let at = node.at + (ix - node.ix());
                return Ok(Node { at, ..node });
            }
            node = self.children(&node)?.find(|child| child.subtree().contains(&ix)).ok_or_else(missing)?;
        }
        Ok(node)
    }

    /// The node of a cube.
    ///
    /// # Errors
    ///
    /// As [`Nodes::children`], for the nodes above it.
    pub fn find(&self, layer: u16, cube: Cube) -> Result<Option<Node>, StoreError> {
        let mut found = self.root(layer)?.filter(|root| root.cube.contains_cube(cube));
        while let Some(node) = found {
            if node.cube == cube {
                return Ok(Some(node));
            }
            found = self.children(&node)?.find(|child| child.cube.contains_cube(cube));
        }
        Ok(None)
    }

    /// All nodes of a layer in pre-order, their pages held: for work on all of them.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if a row is missing or wrong.
    pub fn all(&self, layer: u16) -> Result<Vec<Node>, StoreError> {
        let mut open: Vec<Node> = self.root(layer)?.into_iter().collect();
        let mut all = Vec::new();
        while let Some(node) = open.pop() {
            let before = open.len();
            open.extend(self.children(&node)?);
            open[before..].reverse();
            all.push(node);
        }
        Ok(all)
    }

    /// The zone maps of a node, kept with its row.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if the row is missing or wrong.
    pub fn zones(&self, node: &Node) -> Result<Arc<Zones>, StoreError> {
        let cell = &node.page.zones[node.at as usize];
        if let Some(zones) = cell.get() {
            return Ok(zones.clone());
        }
        let zones = Arc::new(self.snapshot.with(|c| rows::load_zones(c, node.layer, node.cube))?);
        Ok(cell.get_or_init(|| zones).clone())
    }
}

/// The children of a node.
#[derive(Clone, Debug)]
pub struct Children {
    page: Arc<Page>,
    next: u32,
    left: u32,
}

impl Iterator for Children {
    type Item = Node;

    fn next(&mut self) -> Option<Node> {
        self.left = self.left.checked_sub(1)?;
        let node = Node { page: self.page.clone(), at: self.next };
        self.next += if self.page.is_deep { node.subtree_nodes as u32 } else { 1 };
        Some(node)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.left as usize, Some(self.left as usize))
    }
}

impl ExactSizeIterator for Children {}

fn load_roots(connection: &Connection, site: &SiteRow) -> Result<Page, RowError> {
    Ok(Page::family(roots_of(connection, site)?, true, 0))
}

/// The rows of all roots, by layer; their counts are those of all nodes.
pub(super) fn roots_of(connection: &Connection, site: &SiteRow) -> Result<Vec<NodeHead>, RowError> {
    let mut heads = Vec::new();
    for (layer, root) in (0_u16..).zip(&site.site.roots) {
        let Some(cube) = root else { continue };
        let head = rows::load_node(connection, layer, *cube)?
            .ok_or_else(|| RowError::damage("node", format!("layer {layer}"), "the root is missing"))?;
        check_alone(&head, site)?;
        heads.push(head);
    }
    let nodes: u128 = heads.iter().map(|h| u128::from(h.subtree_nodes)).sum();
    if nodes != u128::from(site.nodes) || NodeIx::try_from(site.nodes).is_err() {
        let what = format!("the roots count {nodes}, but {} were written", site.nodes);
        return Err(RowError::damage("node", "all rows", what));
    }
    Ok(heads)
}

/// What lies below a node: all of it if it is small, else its children.
fn load_below(connection: &Connection, site: &SiteRow, node: &Node) -> Result<Page, RowError> {
    let top: &NodeHead = node;
    if top.subtree_points <= PAGE_LEAVES * u64::from(site.site.leaf_capacity) {
        let mut checker = Checker::below(site, top.clone());
        rows::load_nodes_below(connection, top.layer, top.cube, |head| checker.push(head))?;
        checker.close();
        if let Some(first) = checker.damage.into_iter().next() {
            return Err(first);
        }
        let mut roots = vec![false; checker.heads.len()];
        roots[0] = node.is_root();
        return Ok(Page::deep(checker.heads, roots, node.ix()));
    }
    let mut sum = Sum::of(top);
    let mut heads = Vec::new();
    for octant in (0..8).filter(|octant| top.children & 1 << octant != 0) {
        let child = top.cube.child(octant).map(|cube| rows::load_node(connection, top.layer, cube)).transpose()?;
        let missing = || damage(top, format!("the child in octant {octant} is missing"));
        let child = child.flatten().ok_or_else(missing)?;
        check_alone(&child, site)?;
        sum.add(top, &child)?;
        heads.push(child);
    }
    sum.check(top)?;
    Ok(Page::family(heads, false, node.ix() + 1))
}
