//! How large things are: fields of a structure, files of an `impl`, lines and branches of a function, and that a type name means one
//! thing. Read from the syntax tree of `src/`; code below `#[cfg(test)]` does not count.

use std::collections::{BTreeMap, BTreeSet};

use syn::spanned::Spanned;
use syn::visit::{self, Visit};

use super::{CORE, Source, known, report, sources};

/// Fields of one structure of the core.
const MOST_FIELDS: usize = 15;
/// Files that one type's inherent `impl` blocks stand in, in the core.
const MOST_FILES: usize = 3;
/// Lines of one function, from its name to its last brace.
const MOST_LINES: usize = 60;
/// Branches of one function (McCabe 1976, "A complexity measure"): 1, and 1 for each `if`, loop, `&&`, `||` and `?`, and for each arm
/// of a `match` after the first. A `match` that is a table (every arm one value or one call) counts as one branch.
const MOST_BRANCHES: usize = 15;

/// What the sources hold, by name.
#[derive(Default)]
struct Measured {
    /// Fields of the core's structures.
    fields: BTreeMap<String, usize>,
    /// Files of the core's inherent `impl` blocks, by room and type.
    impls: BTreeMap<String, BTreeSet<String>>,
    lines: BTreeMap<String, usize>,
    branches: BTreeMap<String, usize>,
    /// Files that define a type of this name.
    types: BTreeMap<String, BTreeSet<String>>,
}

impl Measured {
    fn of(sources: &[Source]) -> Self {
        let mut all = Self::default();
        // A file of tests that stands beside its module.
        for source in sources.iter().filter(|s| !s.path.ends_with("/tests.rs")) {
            let file = syn::parse_file(&source.text).unwrap_or_else(|e| panic!("{}: {e}", source.path));
            let core = CORE.contains(&source.room.as_str());
            Reader { source, core, owner: None, all: &mut all }.visit_file(&file);
        }
        all
    }
}

/// Walks one file.
struct Reader<'a> {
    source: &'a Source,
    core: bool,
    /// The type whose `impl` block is read.
    owner: Option<String>,
    all: &'a mut Measured,
}

impl Reader<'_> {
    fn type_named(&mut self, name: &syn::Ident) {
        self.all.types.entry(name.to_string()).or_default().insert(self.source.path.clone());
    }

    fn function(&mut self, signature: &syn::Signature, block: &syn::Block) {
        let name = match &self.owner {
            Some(owner) => format!("{owner}::{}", signature.ident),
            None => signature.ident.to_string(),
        };
        let lines = 1 + block.span().end().line - signature.span().start().line;
        let mut branches = Branches(1);
        branches.visit_block(block);
        for (table, n) in [(&mut self.all.lines, lines), (&mut self.all.branches, branches.0)] {
            let most = table.entry(name.clone()).or_default();
            *most = n.max(*most);
        }
    }
}

impl<'ast> Visit<'ast> for Reader<'_> {
    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if !of_tests(&item.attrs) {
            visit::visit_item_mod(self, item);
        }
    }

    fn visit_item_struct(&mut self, item: &'ast syn::ItemStruct) {
        if of_tests(&item.attrs) {
            return;
        }
        self.type_named(&item.ident);
        if self.core {
            let most = self.all.fields.entry(item.ident.to_string()).or_default();
            *most = item.fields.len().max(*most);
        }
    }

    fn visit_item_enum(&mut self, item: &'ast syn::ItemEnum) {
        if !of_tests(&item.attrs) {
            self.type_named(&item.ident);
        }
    }

    fn visit_item_trait(&mut self, item: &'ast syn::ItemTrait) {
        self.type_named(&item.ident);
        let outer = self.owner.replace(item.ident.to_string());
        visit::visit_item_trait(self, item);
        self.owner = outer;
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        if of_tests(&item.attrs) {
            return;
        }
        let name = match item.self_ty.as_ref() {
            syn::Type::Path(path) => path.path.segments.last().map(|s| s.ident.to_string()),
            _ => None,
        };
        if let (true, None, Some(name)) = (self.core, &item.trait_, &name) {
            let key = format!("{}::{name}", self.source.room);
            self.all.impls.entry(key).or_default().insert(self.source.path.clone());
        }
        let outer = std::mem::replace(&mut self.owner, name);
        visit::visit_item_impl(self, item);
        self.owner = outer;
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        if !of_tests(&item.attrs) {
            self.function(&item.sig, &item.block);
        }
    }

    fn visit_trait_item_fn(&mut self, item: &'ast syn::TraitItemFn) {
        if let Some(block) = &item.default {
            self.function(&item.sig, block);
        }
    }

    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        if !of_tests(&item.attrs) {
            self.function(&item.sig, &item.block);
        }
    }
}

fn of_tests(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|a| {
        a.path().is_ident("test")
            || a.path().is_ident("cfg") && a.parse_args::<syn::Path>().is_ok_and(|p| p.is_ident("test"))
    })
}

/// Counts the branches of one function.
struct Branches(usize);

impl<'ast> Visit<'ast> for Branches {
    fn visit_expr(&mut self, e: &'ast syn::Expr) {
        self.0 += match e {
            syn::Expr::If(_) | syn::Expr::While(_) | syn::Expr::ForLoop(_) | syn::Expr::Try(_) => 1,
            syn::Expr::Binary(b) => usize::from(matches!(b.op, syn::BinOp::And(_) | syn::BinOp::Or(_))),
            syn::Expr::Match(m) if is_table(m) => 1,
            syn::Expr::Match(m) => {
                m.arms.len().saturating_sub(1) + m.arms.iter().filter(|a| a.guard.is_some()).count()
            }
            _ => 0,
        };
        visit::visit_expr(self, e);
    }

    /// A `let … else` branches, too.
    fn visit_local_init(&mut self, init: &'ast syn::LocalInit) {
        self.0 += usize::from(init.diverge.is_some());
        visit::visit_local_init(self, init);
    }

    /// Items within a function are functions of their own.
    fn visit_item(&mut self, _: &'ast syn::Item) {}
}

/// Whether every arm is one value, or one call without branches of its own.
fn is_table(m: &syn::ExprMatch) -> bool {
    m.arms.iter().all(|arm| {
        let mut inside = Branches(0);
        inside.visit_expr(&arm.body);
        arm.guard.is_none() && inside.0 == 0 && !matches!(*arm.body, syn::Expr::Block(_))
    })
}

/// Compares what was measured with a limit. What is above it must stand in the list of known exceptions with exactly that number, and
/// what stands there must be above the limit: so the list only shrinks.
fn held(
    what: &str,
    limit: usize,
    found: &BTreeMap<String, usize>,
    exceptions: &[(&str, usize)],
) -> Vec<String> {
    let mut violations = Vec::new();
    for (name, &n) in found {
        match exceptions.iter().find(|(known, _)| known == name) {
            None if n > limit => violations.push(format!("{name}: {n} {what}, more than {limit}")),
            Some((_, known)) if n > *known => violations.push(format!("{name}: {n} {what}, {known} before")),
            _ => {}
        }
    }
    for (name, known) in exceptions {
        match found.get(*name) {
            Some(&n) if n <= limit => {
                violations.push(format!("{name}: {n} {what} now: take it off the list"))
            }
            Some(n) if n < known => {
                violations.push(format!("{name}: {n} {what} now: lower its {known} in the list"))
            }
            None => violations.push(format!("{name}: gone: take it off the list of {what}")),
            Some(_) => {}
        }
    }
    violations
}

fn counted(sets: BTreeMap<String, BTreeSet<String>>) -> BTreeMap<String, usize> {
    sets.into_iter().map(|(name, files)| (name, files.len())).collect()
}

#[test]
fn structures_of_the_core_have_few_fields() {
    report(&held("fields", MOST_FIELDS, &Measured::of(&sources()).fields, known::FIELDS));
}

#[test]
fn a_type_of_the_core_has_its_methods_in_few_files() {
    report(&held("files of impl", MOST_FILES, &counted(Measured::of(&sources()).impls), known::IMPL_FILES));
}

#[test]
fn functions_fit_a_screen() {
    report(&held("lines", MOST_LINES, &Measured::of(&sources()).lines, known::LINES));
}

#[test]
fn functions_have_few_branches() {
    report(&held("branches", MOST_BRANCHES, &Measured::of(&sources()).branches, known::BRANCHES));
}

#[test]
fn a_type_name_means_one_thing() {
    report(&held("files define it", 1, &counted(Measured::of(&sources()).types), known::NAMES));
}

#[test]
fn sizes_are_counted() {
    let text = "struct S { a: u8, b: u8 }\n\
                impl S {\n    fn f(&self) -> Option<u8> {\n        if self.a > 1 && self.b > 1 { return None; }\n        \
                for _ in 0..3 { g()?; }\n        match self.a { 0 => None, 1 => { g() } _ => Some(1) }\n    }\n\
                fn table(&self) -> u8 { match self.a { 0 => 1, 1 => 2, 2 => 3, _ => 4 } }\n}\n\
                #[cfg(test)]\nmod tests { struct T; fn h() {} }\n";
    let source =
        Source { path: "src/geo/s.rs".into(), room: "geo".into(), depth: 2, text: text.into(), code: vec![] };
    let all = Measured::of(&[source]);
    assert_eq!(all.fields["S"], 2);
    assert_eq!((all.lines["S::f"], all.branches["S::f"], all.branches["S::table"]), (5, 7, 2));
    assert!(!all.types.contains_key("T") && !all.lines.contains_key("h"));
    assert_eq!(all.impls["geo::S"].len(), 1);

    let found = BTreeMap::from([("a".to_owned(), 20), ("b".to_owned(), 9), ("c".to_owned(), 17)]);
    assert!(held("lines", 15, &found, &[("a", 20), ("c", 17)]).is_empty());
    assert_eq!(held("lines", 15, &found, &[("a", 21), ("b", 16), ("gone", 16)]).len(), 4);
    assert_eq!(held("lines", 15, &found, &[("a", 19), ("c", 17)]), ["a: 20 lines, 19 before"]);
}
