// Starts `takt plc lsp` for the files of Structured Text. All that it knows comes from there.

const vscode = require("vscode");

let client;

exports.activate = function () {
  let library;
  try {
    library = require("vscode-languageclient/node");
  } catch (error) {
    if (error.code !== "MODULE_NOT_FOUND") throw error;
    vscode.window.showWarningMessage(
      "Structured Text has its colours only: run `npm install` in the folder of the extension " +
        "takt-structured-text for messages, hover and completion.",
    );
    return undefined;
  }
  const command = vscode.workspace.getConfiguration("takt").get("command");
  client = new library.LanguageClient(
    "takt",
    "Structured Text (Takt)",
    { command, args: ["plc", "lsp"] },
    { documentSelector: [{ language: "structured-text" }] },
  );
  return client.start();
};

exports.deactivate = function () {
  return client?.stop();
};
