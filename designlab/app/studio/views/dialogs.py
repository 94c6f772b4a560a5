"""Dialogs: save a design, export its parts, copy what does the same."""

from nicegui import ui

from designlab.app.studio.confinement import OutsideFolder, inside, new_file, shown
from designlab.app.studio.desk import Desk
from designlab.app.studio.messages import ExportJob, Reply
from designlab.app.studio.snippets import command_lines, python_lines
from designlab.app.studio.views.look import FILLED
from designlab.sensor.design import Design, preset_names

TOML = ".toml"


def named(design: Design, name: str, comment: str) -> Design:
    """The design under a name of its own, with a comment; the preset it was made from stays its parent."""
    parent = design.parent
    if parent is None and design.name in preset_names():
        parent = design.name
    told = {"name": name, "parent": parent if parent != name else None}
    return design.model_copy(update={**told, **({"description": comment} if comment else {})})


def save_dialog(page: Desk) -> None:
    """Ask for a name and a comment, and write the design."""
    with ui.dialog() as dialog, ui.card():
        ui.label("Save the design").classes("heading")
        name = ui.input("file name", value="my-design").props('outlined dense autofocus id="save-name"')
        comment = ui.textarea("comment", placeholder="what it is, and why").props("outlined dense")
        name.classes("w-full")
        comment.style("width: 100%")
        replace = ui.checkbox("replace a file that is there")
        wrong = ui.label("").classes("wrong").props('role="alert"')

        def save() -> None:
            try:
                path = new_file(page.root, name.value or "", TOML)
            except OutsideFolder as error:
                wrong.set_text(str(error))
                return
            if path.exists() and not replace.value:
                wrong.set_text(f"{path.name}: already exists; choose another name, or tick the box")
                return
            design = named(page.session.design, path.stem, (comment.value or "").strip())
            try:
                design.save(path)
            except OSError as error:
                wrong.set_text(f"{path.name}: cannot be written: {error.strerror}")
                return
            dialog.close()
            page.saved(shown(page.root, path))
            page.tell(f"{path.name} written")

        with ui.row():
            ui.button("save", on_click=save).props(f'{FILLED} id="save-now"')
            ui.button("cancel", on_click=dialog.close).props("no-caps flat")
    dialog.open()


def export_dialog(page: Desk) -> None:
    """Ask for a folder, and have the worker write the files to make the design."""
    with ui.dialog() as dialog, ui.card():
        ui.label("Export the files to make it").classes("heading")
        ui.label("STL, STEP, 3MF, LED coordinates, bill of materials, and checks of them.").classes("note")
        name = ui.input("folder", value="parts").props("outlined dense autofocus")
        said = ui.label("").classes("note").props('role="status"')

        def done(reply: Reply) -> None:
            if reply.error:
                said.set_text(reply.error)
            elif reply.content is not None:
                warnings = reply.content["warnings"]
                told = f"{reply.content['files']} files written into {name.value}"
                said.set_text(told + (f". {'. '.join(warnings)}" if warnings else ""))

        def export() -> None:
            try:
                out = new_file(page.root, name.value or "", "")
            except OutsideFolder as error:
                said.set_text(str(error))
                return
            said.set_text("writing; this takes some seconds")
            page.ask("export", ExportJob(page.session.design, inside(page.root, out.name)), done, priority=5)

        with ui.row():
            ui.button("export", on_click=export).props(FILLED)
            ui.button("close", on_click=dialog.close).props("no-caps flat")
    dialog.open()


def copy_dialog(page: Desk) -> None:
    """Show command line and Python that do what the page shows."""
    session = page.session
    saved = not session.edits
    file = session.source if saved else "my-design.toml"
    texts = {
        "Command line": command_lines(file, session.press),
        "Python": python_lines(session.source, session.changes, session.press),
    }
    with ui.dialog() as dialog, ui.card():
        for title, text in texts.items():
            ui.label(title).classes("heading")
            if title == "Command line" and not saved:
                ui.label("Save the design as my-design first: the commands read its file.").classes("note")
            ui.label(text).classes("code")
            ui.button("copy", on_click=lambda _, text=text: ui.clipboard.write(text)).props("no-caps flat")
        ui.button("close", on_click=dialog.close).props("no-caps flat")
    dialog.open()
