//! CASE.

use std::collections::BTreeMap;

use cranelift_codegen::ir::condcodes::IntCC;
use cranelift_codegen::ir::{Block, InstBuilder, Value};

use super::lower::Lower;
use crate::hir::{self, CaseArm, Class, Elementary, Expr};

/// Up to so many values are searched by comparisons: a table takes as many instructions as two or three of them.
const SEARCHED: usize = 6;

impl Lower<'_> {
    /// Comparisons in turn for ranges, a search for single values.
    pub(super) fn case(&mut self, selector: &Expr, arms: &[CaseArm], otherwise: &hir::Block) {
        let ty = self.scalar(selector.ty);
        let signed = ty.class() == Class::Signed;
        let value = self.expr(selector);
        let end = self.builder.create_block();
        let blocks: Vec<Block> = arms.iter().map(|_| self.builder.create_block()).collect();
        let (least, greatest) = ty.range().unwrap_or((0, 0));
        let all = || {
            arms.iter()
                .zip(&blocks)
                .flat_map(|(arm, block)| arm.ranges.iter().map(move |range| (range, *block)))
        };
        let single = all().all(|((low, high), _)| low == high);
        let none = self.builder.create_block();
        if single {
            let mut numbers = BTreeMap::new();
            for ((number, _), block) in all() {
                if *number >= least && *number <= greatest {
                    numbers.entry(*number).or_insert(block);
                }
            }
            let numbers: Vec<(i128, Block)> = numbers.into_iter().collect();
            self.search(ty, value, &numbers, none);
        } else {
            for (&(low, high), block) in all() {
                let (low, high) = (low.max(least), high.min(greatest));
                if low > high {
                    continue;
                }
                let from = self.integer(ty, low);
                let distance = self.builder.ins().isub(value, from);
                // One unsigned comparison of the distance from the lower bound, as for an index.
                let width = self.integer(ty, high - low);
                let within =
                    self.builder.ins().icmp(IntCC::UnsignedLessThanOrEqual, distance, width);
                debug_assert!(signed || low >= 0);
                let next = self.builder.create_block();
                self.builder.ins().brif(within, block, &[], next, &[]);
                self.builder.switch_to_block(next);
            }
            self.builder.ins().jump(none, &[]);
        }
        for (arm, block) in arms.iter().zip(&blocks) {
            self.builder.switch_to_block(*block);
            self.block(&arm.body);
            self.builder.ins().jump(end, &[]);
        }
        self.builder.switch_to_block(none);
        self.block(otherwise);
        self.builder.ins().jump(end, &[]);
        self.builder.switch_to_block(end);
    }

    /// Goes to the block of the number that the value is; `numbers` ascend. Many are left to Cranelift's switch, which
    /// makes tables of those that lie close together.
    fn search(&mut self, ty: Elementary, value: Value, numbers: &[(i128, Block)], none: Block) {
        if numbers.len() > SEARCHED {
            let mut switch = cranelift_frontend::Switch::new();
            let mask = (1u128 << (ty.size() * 8)) - 1;
            for (number, block) in numbers {
                switch.set_entry(*number as u128 & mask, *block);
            }
            switch.emit(&mut self.builder, value, none);
            return;
        }
        if numbers.len() > 2 {
            let (below, from) = numbers.split_at(numbers.len() / 2);
            let middle = self.integer(ty, from[0].0);
            let less = match ty.class() {
                Class::Signed => IntCC::SignedLessThan,
                _ => IntCC::UnsignedLessThan,
            };
            let less = self.builder.ins().icmp(less, value, middle);
            let (left, right) = (self.builder.create_block(), self.builder.create_block());
            self.builder.ins().brif(less, left, &[], right, &[]);
            self.builder.switch_to_block(left);
            self.search(ty, value, below, none);
            self.builder.switch_to_block(right);
            self.search(ty, value, from, none);
            return;
        }
        for (number, block) in numbers {
            let number = self.integer(ty, *number);
            let equal = self.builder.ins().icmp(IntCC::Equal, value, number);
            let next = self.builder.create_block();
            self.builder.ins().brif(equal, *block, &[], next, &[]);
            self.builder.switch_to_block(next);
        }
        self.builder.ins().jump(none, &[]);
    }
}
