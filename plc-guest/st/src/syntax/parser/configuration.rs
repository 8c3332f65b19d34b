//! CONFIGURATION, RESOURCE, TASK and instances of programs.

use super::{Parse, Parser, Told};
use crate::source::Span;
use crate::syntax::ast::{Configuration, Placement, ProgramInstance, Resource, Retention, Task};
use crate::syntax::token::{Keyword, Sign, TokenKind};

impl Parser<'_> {
    pub(super) fn configuration(&mut self) -> Parse<Configuration> {
        let open = self.advance();
        let name = self.name("the name of the configuration")?;
        let mut globals = Vec::new();
        let mut placements = Vec::new();
        let mut resources = Vec::new();
        // Tasks and programs outside of a resource are in one without a name.
        let mut bare = empty(None, open);
        loop {
            if self.at_keyword(Keyword::Resource) {
                resources.push(self.resource()?);
            } else if self.at_keyword(Keyword::VarGlobal) {
                globals.extend(self.section()?);
            } else if self.at_keyword(Keyword::VarConfig) {
                self.placements(&mut placements);
            } else if !self.resource_element(&mut bare)? {
                break;
            }
        }
        if !bare.tasks.is_empty() || !bare.programs.is_empty() {
            bare.span = open.to(self.previous);
            resources.push(bare);
        }
        self.close(Keyword::EndConfiguration, open)?;
        self.eat_sign(Sign::Semicolon);
        Ok(Configuration { name, globals, placements, resources, span: open.to(self.previous) })
    }

    /// `VAR_CONFIG ... END_VAR`
    fn placements(&mut self, into: &mut Vec<Placement>) {
        let open = self.advance();
        loop {
            while self.eat_sign(Sign::Semicolon).is_some() {}
            if self.current.kind != TokenKind::Identifier {
                break;
            }
            match self.placement() {
                Ok(placement) => into.push(placement),
                Err(Told) => self.skip_to(|kind| {
                    matches!(
                        kind,
                        TokenKind::Sign(Sign::Semicolon)
                            | TokenKind::Keyword(
                                Keyword::EndVar
                                    | Keyword::EndConfiguration
                                    | Keyword::Task
                                    | Keyword::Program
                                    | Keyword::Resource
                            )
                    )
                }),
            }
        }
        // Without it, what follows is read all the same.
        let _ = self.close(Keyword::EndVar, open);
        self.eat_sign(Sign::Semicolon);
    }

    fn placement(&mut self) -> Parse<Placement> {
        let start = self.current.span;
        let path = self.postfix()?;
        let address = match self.eat_keyword(Keyword::At) {
            Some(_) if self.current.kind != TokenKind::Address => {
                return Err(self.unexpected("an address such as `%IX0.0`"));
            }
            Some(_) => Some(self.address()?),
            None => None,
        };
        self.expect_sign(Sign::Colon)?;
        let spec = self.type_spec()?;
        let initial = match self.eat_sign(Sign::Assign) {
            Some(_) => Some(self.initial()?),
            None => None,
        };
        let span = start.to(self.previous);
        self.end_of_declaration()?;
        Ok(Placement { path, address, spec, initial, span })
    }

    fn resource(&mut self) -> Parse<Resource> {
        let open = self.advance();
        let name = self.name("the name of the resource")?;
        // No keyword, because values of enumerations are so often named On.
        let processor = match self.text(self.current.span).eq_ignore_ascii_case("ON") {
            true => {
                self.advance();
                self.name("the type of the processor")?
            }
            // What is within is read all the same.
            false => {
                self.missing("ON");
                name.clone()
            }
        };
        let mut resource = empty(Some((name, processor)), open);
        loop {
            if self.at_keyword(Keyword::VarGlobal) {
                resource.globals.extend(self.section()?);
            } else if !self.resource_element(&mut resource)? {
                break;
            }
        }
        self.close(Keyword::EndResource, open)?;
        self.eat_sign(Sign::Semicolon);
        resource.span = open.to(self.previous);
        Ok(resource)
    }

    /// A task, a program or something that is refused. False if none begins here.
    fn resource_element(&mut self, resource: &mut Resource) -> Parse<bool> {
        let read = match self.current.kind {
            TokenKind::Keyword(Keyword::Task) => self.task().map(|task| resource.tasks.push(task)),
            TokenKind::Keyword(Keyword::Program) => {
                self.program_instance().map(|program| resource.programs.push(program))
            }
            TokenKind::Sign(Sign::Semicolon) => {
                self.advance();
                Ok(())
            }
            _ => return Ok(self.refuse_block()),
        };
        if let Err(Told) = read {
            self.skip_to(|kind| {
                matches!(
                    kind,
                    TokenKind::Sign(Sign::Semicolon)
                        | TokenKind::Keyword(
                            Keyword::EndConfiguration
                                | Keyword::EndResource
                                | Keyword::Task
                                | Keyword::Program
                                | Keyword::Resource
                        )
                )
            });
        }
        Ok(true)
    }

    fn task(&mut self) -> Parse<Task> {
        let open = self.advance();
        let name = self.name("the name of the task")?;
        self.expect_sign(Sign::OpenParenthesis)?;
        let mut properties = Vec::new();
        loop {
            let property = self.name("INTERVAL, SINGLE or PRIORITY")?;
            self.expect_sign(Sign::Assign)?;
            properties.push((property, self.expression()?));
            if self.eat_sign(Sign::Comma).is_none() {
                break;
            }
        }
        self.expect_sign(Sign::CloseParenthesis)?;
        self.expect_sign(Sign::Semicolon)?;
        Ok(Task { name, properties, span: open.to(self.previous) })
    }

    fn program_instance(&mut self) -> Parse<ProgramInstance> {
        let open = self.advance();
        let retention = match self.current.kind {
            TokenKind::Keyword(Keyword::Retain) => Some((Retention::Retain, self.advance())),
            TokenKind::Keyword(Keyword::NonRetain) => Some((Retention::NonRetain, self.advance())),
            _ => None,
        };
        let name = self.name("the name of the program's instance")?;
        let task = match self.eat_keyword(Keyword::With) {
            Some(_) => Some(self.name("the name of a task")?),
            None => None,
        };
        self.expect_sign(Sign::Colon)?;
        let program = self.name("the name of a program")?;
        let mut arguments = Vec::new();
        if self.eat_sign(Sign::OpenParenthesis).is_some() {
            arguments = self.arguments()?;
        }
        self.expect_sign(Sign::Semicolon)?;
        let span = open.to(self.previous);
        Ok(ProgramInstance { name, retention, task, program, arguments, span })
    }
}

fn empty(
    name: Option<(crate::syntax::ast::Name, crate::syntax::ast::Name)>,
    span: Span,
) -> Resource {
    Resource { name, globals: Vec::new(), tasks: Vec::new(), programs: Vec::new(), span }
}
