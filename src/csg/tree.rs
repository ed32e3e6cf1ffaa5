//! The expression as the user wrote it: a flat arena in post-order.

use std::fmt;

use super::LeafId;
use super::bits::BitStack;
use super::positive::Positive;

/// One node of a [`Tree`]; operands are indices of earlier nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Node {
    /// A leaf of the scene.
    Leaf(LeafId),
    /// Complement, `!a`.
    Not(u32),
    /// Intersection, `a & b`.
    And(u32, u32),
    /// Union, `a | b`.
    Or(u32, u32),
    /// Difference, `a - b`.
    Minus(u32, u32),
}

/// An expression tree, never empty.
///
/// Nodes are in post-order: the left operand's nodes, the right operand's nodes, the operator; the root is last. So every
/// subtree is a contiguous run, each node is the operand of exactly one other, and a single pass over the arena with a
/// stack evaluates it.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Tree {
    nodes: Vec<Node>,
}

impl Tree {
    /// The tree of one leaf.
    pub fn leaf(id: LeafId) -> Self {
        Self { nodes: vec![Node::Leaf(id)] }
    }

    /// The complement of `a`. Constant time.
    #[expect(clippy::should_implement_trait, reason = "a function like its siblings, which have no operators either")]
    pub fn not(a: Self) -> Self {
        let mut nodes = a.nodes;
        nodes.push(Node::Not(index(nodes.len() - 1)));
        Self { nodes }
    }

    /// The intersection of `a` and `b`. Linear in `b` alone, as are `or` and `minus`.
    pub fn and(a: Self, b: Self) -> Self {
        Self::binary(a, b, Node::And)
    }

    /// The union of `a` and `b`.
    pub fn or(a: Self, b: Self) -> Self {
        Self::binary(a, b, Node::Or)
    }

    /// The difference of `a` and `b`.
    pub fn minus(a: Self, b: Self) -> Self {
        Self::binary(a, b, Node::Minus)
    }

    fn binary(a: Self, b: Self, operator: fn(u32, u32) -> Node) -> Self {
        let mut nodes = a.nodes;
        let shift = index(nodes.len());
        nodes.extend(b.nodes.into_iter().map(|node| match node {
            Node::Leaf(id) => Node::Leaf(id),
            Node::Not(a) => Node::Not(a + shift),
            Node::And(a, b) => Node::And(a + shift, b + shift),
            Node::Or(a, b) => Node::Or(a + shift, b + shift),
            Node::Minus(a, b) => Node::Minus(a + shift, b + shift),
        }));
        nodes.push(operator(shift - 1, index(nodes.len() - 1)));
        Self { nodes }
    }

    /// The nodes in post-order, the root last.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The root: the last node.
    pub fn root(&self) -> Node {
        *self.nodes.last().expect("a tree has at least one node")
    }

    /// Whether a point is inside the result, given which leaves it is inside of. Asks for every occurrence of every leaf,
    /// left to right; where a question is costly, walk the [`Blist`](super::Blist) instead.
    pub fn eval(&self, mut inside: impl FnMut(LeafId) -> bool) -> bool {
        let mut stack = BitStack::default();
        for node in &self.nodes {
            let value = match node {
                Node::Leaf(id) => inside(*id),
                Node::Not(_) => !stack.pop(),
                operator => {
                    let b = stack.pop();
                    let a = stack.pop();
                    match operator {
                        Node::And(..) => a && b,
                        Node::Or(..) => a || b,
                        _ => a && !b,
                    }
                }
            };
            stack.push(value);
        }
        stack.pop()
    }

    /// The leaves that occur, sorted, each once.
    pub fn leaves(&self) -> Vec<LeafId> {
        let occurring = self.nodes.iter().filter_map(|node| if let Node::Leaf(id) = node { Some(*id) } else { None });
        sorted_unique(occurring.collect())
    }

    /// The same tree over other leaves. Two names for the same content become one leaf this way.
    pub fn map_leaves(&self, mut to: impl FnMut(LeafId) -> LeafId) -> Self {
        let map = |node: &Node| if let Node::Leaf(id) = node { Node::Leaf(to(*id)) } else { *node };
        Self { nodes: self.nodes.iter().map(map).collect() }
    }

    /// The tree with only unions and intersections, complements pushed to the leaves.
    pub fn positive(&self) -> Positive {
        Positive::from(self)
    }

    /// The expression as text that [`parse`](super::expression::parse) reads back to an equal tree: parentheses only
    /// where they are needed, names quoted only where they are not plain words. `name` tells a leaf's name.
    pub fn display<F, N>(&self, name: F) -> DisplayTree<'_, F>
    where
        F: Fn(LeafId) -> N,
        N: AsRef<str>,
    {
        DisplayTree { tree: self, name }
    }
}

/// An arena index. Arenas are bounded by [`TreeBuilder`], which counts, and elsewhere by memory: 2^32 nodes of 12 bytes.
pub(super) fn index(position: usize) -> u32 {
    u32::try_from(position).expect("an expression has fewer than 2^32 nodes")
}

/// Sorts and removes repetitions.
pub(super) fn sorted_unique(mut leaves: Vec<LeafId>) -> Vec<LeafId> {
    leaves.sort_unstable();
    leaves.dedup();
    leaves
}

/// Builds a [`Tree`] as a pocket calculator does: leaves are put on a stack, operators take their operands from it.
///
/// ```
/// use surfcut::csg::{LeafId, TreeBuilder};
/// let mut builder = TreeBuilder::default();
/// builder.leaf(LeafId(0)).leaf(LeafId(1)).minus(); // a - b
/// let tree = builder.finish().unwrap();
/// assert!(tree.eval(|leaf| leaf == LeafId(0)));
/// ```
#[derive(Debug, Clone, Default)]
pub struct TreeBuilder {
    nodes: Vec<Node>,
    /// The finished subtrees that no operator has taken yet: their roots.
    roots: Vec<u32>,
    /// An operator lacked an operand, or there were more nodes than an index can name.
    broken: bool,
}

impl TreeBuilder {
    /// Puts a leaf on the stack.
    pub fn leaf(&mut self, id: LeafId) -> &mut Self {
        self.push(Node::Leaf(id))
    }

    /// Replaces the newest subtree by its complement.
    pub fn not(&mut self) -> &mut Self {
        match self.roots.pop() {
            Some(a) => self.push(Node::Not(a)),
            None => self.fail(),
        }
    }

    /// Replaces the two newest subtrees, `a` and then `b`, by `a & b`.
    pub fn and(&mut self) -> &mut Self {
        self.binary(Node::And)
    }

    /// Replaces the two newest subtrees, `a` and then `b`, by `a | b`.
    pub fn or(&mut self) -> &mut Self {
        self.binary(Node::Or)
    }

    /// Replaces the two newest subtrees, `a` and then `b`, by `a - b`.
    pub fn minus(&mut self) -> &mut Self {
        self.binary(Node::Minus)
    }

    /// The tree; `None` unless exactly one subtree is left on the stack and no operator ever lacked an operand.
    pub fn finish(self) -> Option<Tree> {
        (!self.broken && self.roots.len() == 1).then_some(Tree { nodes: self.nodes })
    }

    fn binary(&mut self, operator: fn(u32, u32) -> Node) -> &mut Self {
        match (self.roots.pop(), self.roots.pop()) {
            (Some(b), Some(a)) => self.push(operator(a, b)),
            _ => self.fail(),
        }
    }

    fn push(&mut self, node: Node) -> &mut Self {
        match u32::try_from(self.nodes.len()) {
            Ok(position) => {
                self.nodes.push(node);
                self.roots.push(position);
                self
            }
            Err(_) => self.fail(),
        }
    }

    fn fail(&mut self) -> &mut Self {
        self.broken = true;
        self
    }
}

/// How tightly a node binds: a child that binds less tightly than its place asks for is parenthesised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Binding {
    Anything,
    Sum,
    Product,
    Complement,
    Leaf,
}

impl Node {
    fn binding(&self) -> Binding {
        match self {
            Self::Or(..) | Self::Minus(..) => Binding::Sum,
            Self::And(..) => Binding::Product,
            Self::Not(_) => Binding::Complement,
            Self::Leaf(_) => Binding::Leaf,
        }
    }
}

/// Prints a [`Tree`]; see [`Tree::display`].
#[derive(Debug)]
pub struct DisplayTree<'a, F> {
    tree: &'a Tree,
    name: F,
}

impl<F, N> fmt::Display for DisplayTree<'_, F>
where
    F: Fn(LeafId) -> N,
    N: AsRef<str>,
{
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        enum Item {
            Subtree { root: u32, at_least: Binding },
            Text(&'static str),
        }
        let nodes = &self.tree.nodes;
        let mut to_do = vec![Item::Subtree { root: index(nodes.len() - 1), at_least: Binding::Anything }];
        while let Some(item) = to_do.pop() {
            let (root, at_least) = match item {
                Item::Text(text) => {
                    f.write_str(text)?;
                    continue;
                }
                Item::Subtree { root, at_least } => (root, at_least),
            };
            let node = &nodes[root as usize];
            if node.binding() < at_least {
                f.write_str("(")?;
                to_do.push(Item::Text(")"));
            }
            // Operators are left-associative, so the right operand must bind more tightly than its operator.
            let (a, operator, b, right) = match *node {
                Node::Leaf(id) => {
                    write_name(f, (self.name)(id).as_ref())?;
                    continue;
                }
                Node::Not(a) => {
                    f.write_str("!")?;
                    to_do.push(Item::Subtree { root: a, at_least: Binding::Complement });
                    continue;
                }
                Node::And(a, b) => (a, " & ", b, Binding::Complement),
                Node::Or(a, b) => (a, " | ", b, Binding::Product),
                Node::Minus(a, b) => (a, " - ", b, Binding::Product),
            };
            to_do.push(Item::Subtree { root: b, at_least: right });
            to_do.push(Item::Text(operator));
            to_do.push(Item::Subtree { root: a, at_least: node.binding() });
        }
        Ok(())
    }
}

/// Whether `c` may stand in a name without quotes.
pub(super) fn is_name_char(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Writes a leaf's name, in quotes where it is not a plain word.
fn write_name(f: &mut fmt::Formatter<'_>, name: &str) -> fmt::Result {
    if !name.is_empty() && name.chars().all(is_name_char) {
        return f.write_str(name);
    }
    f.write_str("\"")?;
    for piece in name.split_inclusive(['"', '\\']) {
        // The character to be escaped ends its piece.
        match piece.strip_suffix(['"', '\\']) {
            Some(before) => write!(f, "{before}\\{}", &piece[before.len()..])?,
            None => f.write_str(piece)?,
        }
    }
    f.write_str("\"")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn leaf(id: u32) -> Tree {
        Tree::leaf(LeafId(id))
    }

    fn letters(id: LeafId) -> String {
        char::from(b'a' + id.0 as u8).to_string()
    }

    #[test]
    fn builder_and_functions_agree() {
        let mut builder = TreeBuilder::default();
        builder.leaf(LeafId(0)).leaf(LeafId(1)).leaf(LeafId(2)).not().or().minus();
        let by_hand = Tree::minus(leaf(0), Tree::or(leaf(1), Tree::not(leaf(2))));
        assert_eq!(builder.finish(), Some(by_hand));
    }

    #[test]
    fn unfinished_builders_give_nothing() {
        assert_eq!(TreeBuilder::default().finish(), None);
        let mut two = TreeBuilder::default();
        two.leaf(LeafId(0)).leaf(LeafId(1));
        assert_eq!(two.finish(), None);
        let mut lacking = TreeBuilder::default();
        lacking.leaf(LeafId(0)).and().leaf(LeafId(1));
        assert_eq!(lacking.finish(), None);
        let mut nothing_to_negate = TreeBuilder::default();
        nothing_to_negate.not().leaf(LeafId(0));
        assert_eq!(nothing_to_negate.finish(), None);
    }

    #[test]
    fn leaves_are_sorted_and_unique() {
        let tree = Tree::and(Tree::or(leaf(7), leaf(2)), Tree::minus(leaf(7), leaf(0)));
        assert_eq!(tree.leaves(), [LeafId(0), LeafId(2), LeafId(7)]);
        let merged = tree.map_leaves(|leaf| if leaf == LeafId(7) { LeafId(2) } else { leaf });
        assert_eq!(merged.leaves(), [LeafId(0), LeafId(2)]);
    }

    #[test]
    fn prints_with_as_few_parentheses_as_the_grammar_allows() {
        let cases = [
            (Tree::or(leaf(0), Tree::and(leaf(1), leaf(2))), "a | b & c"),
            (Tree::and(Tree::or(leaf(0), leaf(1)), leaf(2)), "(a | b) & c"),
            (Tree::minus(Tree::or(leaf(0), leaf(1)), leaf(2)), "a | b - c"),
            (Tree::or(leaf(0), Tree::minus(leaf(1), leaf(2))), "a | (b - c)"),
            (Tree::minus(leaf(0), Tree::or(leaf(1), leaf(2))), "a - (b | c)"),
            (Tree::and(leaf(0), Tree::and(leaf(1), leaf(2))), "a & (b & c)"),
            (Tree::not(Tree::not(Tree::and(leaf(0), leaf(1)))), "!!(a & b)"),
            (Tree::and(Tree::not(leaf(0)), Tree::not(leaf(1))), "!a & !b"),
        ];
        for (tree, text) in cases {
            assert_eq!(tree.display(letters).to_string(), text);
        }
    }

    #[test]
    fn names_are_quoted_where_they_are_no_words() {
        let quoted = |name: &'static str| leaf(0).display(|_| name).to_string();
        assert_eq!(quoted("femur_2"), "femur_2");
        assert_eq!(quoted("2nd"), "2nd");
        assert_eq!(quoted("Hüfte"), "Hüfte");
        assert_eq!(quoted("femur-head"), r#""femur-head""#);
        assert_eq!(quoted(""), r#""""#);
        assert_eq!(quoted(r#"a "b" \c"#), r#""a \"b\" \\c""#);
    }
}
